"""What a force sees of the simulations that it acts in, and what a force is."""

from typing import Protocol

import numpy as np
from mujoco import batch

APPLIED = ("qfrc_applied", "xfrc_applied")
# Fields that are no state and that forces read together: one call of MuJoCo fills all of them
TOGETHER = (("qfrc_spring", "qfrc_gravcomp", "qfrc_fluid", "qfrc_bias"), ("qLD", "qLDiagInv"))


class World:
    """What a force sees: live arrays over the simulations of a running chunk, (simulation, ...), SI units.

    rows: which simulations of the whole call these are, to pick per-simulation coefficients with.
    Any MjData field can be read as an attribute; fields that are not state lag by one step, as in mj_step, except at
    the first step. There the acceleration, qacc, is that under the forces that were added before it is first read.
    stepped: whether that step is done. recorded: whether the motion is known, and does not answer to what is added.
    """

    recorded = False

    def __init__(self, runner: batch.Batch, rows: np.ndarray):
        self._runner = runner
        self.stepped = False
        self.rows = rows
        self._varied: dict[str, tuple[np.ndarray, np.ndarray]] = {}

    def __getattr__(self, name: str) -> np.ndarray:
        names = next((group for group in TOGETHER if name in group), (name,))
        values = {each: self._runner.bind(each) for each in names}
        is_state = values[name].flags.writeable
        if not is_state:  # filled by the next call only
            self._work_out()
        vars(self).update(values)
        return values[name]

    def _work_out(self) -> None:
        """Fill the fields that are no state: in the first step under the forces under which qacc was first read."""
        applied = [self._runner.bind(name) for name in APPLIED]
        now = [force.copy() for force in applied]
        if self.stepped or "qacc" not in vars(self):
            self._applied = now
        for force, then in zip(applied, self._applied, strict=True):
            force[...] = then
        self._runner.forward()
        for force, own in zip(applied, now, strict=True):
            force[...] = own

    def vary(self, name: str) -> np.ndarray:
        """Live values of a model field that a force changes with the state, (simulation, ...).

        At every step they begin as the simulation's own. Only for fields from which no constant derives, such as
        "dof_damping" and "dof_frictionloss": MuJoCo then integrates the change implicitly.
        """
        if name not in self._varied:
            live = self._runner.expand(name)
            self._varied[name] = (live, live.copy())
        return self._varied[name][0]

    def restore_varied(self, keep=...) -> None:
        """Give the varied fields of the simulations `keep` (all) their own values back."""
        for live, own in self._varied.values():
            live[keep] = own[keep]


class Force(Protocol):
    """A state-dependent force: adds to `world.qfrc_applied` (N or N m), `world.xfrc_applied` or `world.vary(...)`.

    A method `report`, where it has one, may change what the sensors show of each step, (simulation, nsensordata).

    One that keeps numbers from step to step says how many: `remembers`. After a call `remembered()` has them,
    (simulation, number), and after `recall(numbers)` it goes on from these in the next world that it is called in, not
    as where a simulation begins.
    """

    def __call__(self, world: World) -> None: ...
