"""What effects along a tendon share."""

from __future__ import annotations

from functools import lru_cache

import mujoco
import numpy as np

from capture_cli.effects._places import site_id
from capture_cli.effects._scales import (
    HINGE,
    SLIDE,
    characteristic_force,
    characteristic_speed,
    inertia,
    travel,
)
from capture_cli.effects.base import GLOBAL, Effect, JointMotion
from capture_cli.parameters import Parameter
from capture_cli.sim.object_names import object_name

STEP = 1e-4  # m or rad, of the differences that levers are taken by
# Of its longest lever: a joint with a shorter one says little of the forces that the tendon carries
LONG = 0.5


class TendonEffect(Effect):
    """An effect along a tendon, whose length is in m, or, where it couples hinges by ratios, in rad.

    levers (joint,): by how much it grows with each joint, at qpos0; 0 for joints with several degrees of freedom.
    """

    place = "model"
    where = "every tendon that a hinge or slide joint moves"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.tendon = site_id(model, "tendon", site)
        self.levers = _levers(model)[:, self.tendon]
        self._seen: dict[int, JointMotion] = {}

    @classmethod
    def sites(cls, model):
        moved = _levers(model).any(axis=0)
        return [object_name(model, "tendon", t) for t in range(model.ntendon) if moved[t]]

    def look_in(self, *, seen, **log):
        super().look_in(seen=seen, **log)
        self._seen = {j: seen[j] for j in np.flatnonzero(self.levers) if j in seen}

    @property
    def characteristic_force(self) -> float:
        """N, or N m over hinges: the most that what moves its joints is along it."""
        return max(characteristic_force(self.model, j) / abs(self.levers[j]) for j in self._pulled)

    @property
    def inertia(self) -> float:
        """kg, or kg m^2 over hinges: the most that one of its joints moves, as felt along it."""
        return max(inertia(self.model, j) / self.levers[j] ** 2 for j in self._pulled)

    @property
    def _pulled(self) -> np.ndarray:
        """The joints that it has a long lever at."""
        size = np.abs(self.levers)
        return np.flatnonzero(size >= LONG * size.max())

    @property
    def characteristic_speed(self) -> float:
        """m/s, or rad/s over hinges."""
        return max(abs(self.levers[j]) * self._speed(j) for j in np.flatnonzero(self.levers))

    def _speed(self, joint: int) -> float:
        speed = characteristic_speed(self.model, joint)
        return min(speed, self._seen[joint].speed) if joint in self._seen else speed

    @property
    def reach(self) -> tuple[float, float]:
        """m or rad: the shortest and longest that it can be where its joints go in the log, or else in their travel."""
        ends = np.sort([self.levers[j] * self._away(j) for j in np.flatnonzero(self.levers)], axis=1).sum(
            axis=0
        )
        shortest, longest = float(self.model.tendon_length0[self.tendon]) + ends
        return float(shortest), float(longest)

    def _away(self, joint: int) -> np.ndarray:
        """How far from qpos0 the joint goes, to either side, (2,)."""
        if joint not in self._seen:
            return travel(self.model, joint) * np.array([-1.0, 1.0])
        seen = self._seen[joint]
        return np.array([seen.low, seen.high]) - self.model.qpos0[self.model.jnt_qposadr[joint]]

    def unit(self, long: str, turned: str) -> str:
        """The unit of a quantity of this tendon, whose length is `long` in m, and over hinges alone may be rad."""
        joints = self.model.jnt_type[np.flatnonzero(self.levers)]
        return f"{long} or {turned}" if self._is_fixed and (joints == HINGE).all() else long

    @property
    def _is_fixed(self) -> bool:
        first = self.model.wrap_type[self.model.tendon_adr[self.tendon]]
        return int(first) == int(mujoco.mjtWrap.mjWRAP_JOINT)

    def added(self, name: str, unit: str, own: float, high: float) -> Parameter:
        """A parameter added to the model's `own` value, such that the sum is not negative."""
        return Parameter(name, unit, min(0.0, -own), high, 0.0)


@lru_cache(maxsize=16)
def _levers(model: mujoco.MjModel) -> np.ndarray:
    """(joint, tendon): by how much each tendon grows with each hinge and slide joint, at qpos0."""
    data, levers = mujoco.MjData(model), np.zeros((model.njnt, model.ntendon))
    for joint in np.flatnonzero(np.isin(model.jnt_type, (HINGE, SLIDE))) if model.ntendon else ():
        ends = []
        for side in (STEP, -STEP):
            data.qpos[:] = model.qpos0
            data.qpos[model.jnt_qposadr[joint]] += side
            mujoco.mj_fwdPosition(model, data)
            ends.append(data.ten_length.copy())
        levers[joint] = (ends[0] - ends[1]) / (2 * STEP)
    return np.where(np.abs(levers) > STEP, levers, 0.0)
