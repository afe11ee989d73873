"""What forces see along a motion that is known, where nothing has to be simulated."""

from collections.abc import Callable, Sequence

import mujoco
import numpy as np
from mujoco import batch

from capture_cli.model.world import APPLIED

# fields whose change is a force at the joint, or inertia of it alone: neither takes a calculation by MuJoCo
AT_JOINTS = ("dof_frictionloss", "dof_damping")
OF_INERTIA = ("dof_armature", "dof_M0")


class RecordedWorld:
    """As `model.world.World`, along the points `index` (lane, step) of fields of MjData that are recorded.

    record: the values (point, ...) of a field. What a force changes at a step is as it was at the next.
    """

    recorded = True

    def __init__(self, model: mujoco.MjModel, record: Callable[[str], np.ndarray], index: np.ndarray):
        self._model, self._record, self._index, self._step = model, record, np.ascontiguousarray(index.T), 0
        self.rows = np.arange(len(index))
        self._series: dict[str, np.ndarray] = {}
        self._varied: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        for name, shape in zip(APPLIED, ((model.nv,), (model.nbody, 6)), strict=True):
            setattr(self, name, self._vary(name, np.zeros(shape)))

    def __getattr__(self, name: str) -> np.ndarray:
        self._series[name] = self._record(name)[self._index]
        setattr(self, name, self._series[name][self._step])
        return getattr(self, name)

    def go_to(self, step: int) -> None:
        """Show another step, with nothing changed."""
        self._step = step
        for name, series in self._series.items():
            setattr(self, name, series[step])
        for live, own in self._varied.values():
            live[...] = own

    def vary(self, name: str) -> np.ndarray:
        """Values of a model field that a force changes, (lane, ...)."""
        if name not in self._varied:
            self._vary(name, getattr(self._model, name))
        return self._varied[name][0]

    @property
    def is_changed_elsewhere(self) -> bool:
        """Whether the force changes anything but what joints feel."""
        return self.changes(but=(APPLIED[0], *AT_JOINTS, *OF_INERTIA))

    def changes(self, but: Sequence[str]) -> bool:
        """Whether the force changes anything but these fields."""
        return any((live != own).any() for name, (live, own) in self._varied.items() if name not in but)

    def changed(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Those of these fields that the force changes, (lane, ...) each."""
        own = {name: self._varied[name] for name in names if name in self._varied}
        return {name: live for name, (live, before) in own.items() if (live != before).any()}

    def write(self, runner: batch.Batch) -> None:
        """Give simulations, one for each lane, what is applied and varied at this step."""
        for name, (live, _) in self._varied.items():
            field = runner.bind(name) if name in APPLIED else runner.expand(name)
            field[...] = live

    def _vary(self, name: str, own: np.ndarray) -> np.ndarray:
        live = np.repeat(np.asarray(own, dtype=float)[None], len(self.rows), axis=0)
        self._varied[name] = live, live.copy()
        return live
