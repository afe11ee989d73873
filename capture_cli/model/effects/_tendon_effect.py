"""What effects along a tendon share."""

from functools import lru_cache

import mujoco
import numpy as np

from capture_cli.model.effects._places import site_id
from capture_cli.model.effects._scales import (
    HINGE,
    SLIDE,
    characteristic_force,
    characteristic_speed,
    inertia,
    travel,
)
from capture_cli.model.effects.base import GLOBAL, Effect, JointMotion
from capture_cli.model.object_names import object_name

TAUT = 1e-4  # m/rad or 1: a lever under this moves nothing


class TendonEffect(Effect):
    """An effect along a tendon, whose length is in m, or, where it couples hinges by ratios, in rad.

    levers (joint,): by how much it grows or shrinks with each joint, at most, where that goes.
    shortest, longest: its length there, m or rad.
    """

    place = "model"
    where = "every tendon that hinge and slide joints move, and no others"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.tendon = site_id(model, "tendon", site)
        self._look_where({})

    @classmethod
    def sites(cls, model):
        return [object_name(model, "tendon", t) for t in range(model.ntendon) if cls.suits(model, t)]

    @classmethod
    def suits(cls, model: mujoco.MjModel, tendon: int) -> bool:
        """Whether the effect can sit along the tendon."""
        dofs = moving_dofs(model, tendon)
        return bool(len(dofs)) and np.isin(model.jnt_type[model.dof_jntid[dofs]], (HINGE, SLIDE)).all()

    def look_in(self, log):
        super().look_in(log)
        self._look_where(log.seen)

    def _look_where(self, seen: dict[int, JointMotion]) -> None:
        """Find levers and lengths where its joints go: in the log, for those that are `seen`."""
        lengths, levers = _moved(self.model, _boxes(self.model, seen))
        self.levers = np.zeros(self.model.njnt)
        moves = moving_dofs(self.model, self.tendon)
        self.levers[self.model.dof_jntid[moves]] = np.maximum(levers[moves, self.tendon], TAUT)
        self.shortest, self.longest = (float(ends) for ends in lengths[:, self.tendon])
        self._speeds = {j: m.speed for j, m in seen.items()}

    @property
    def characteristic_force(self) -> float:
        """N, or N m over hinges: the most that what moves its joints is along it."""
        return max(characteristic_force(self.model, j) / self.levers[j] for j in self._pulled)

    @property
    def inertia(self) -> float:
        """kg, or kg m^2 over hinges: the most that one of its joints moves, as felt along it."""
        return max(inertia(self.model, j) / self.levers[j] ** 2 for j in self._pulled)

    @property
    def _pulled(self) -> np.ndarray:
        """The joints that it has a long lever at."""
        # Of its longest lever: a joint with a shorter one says little of the forces that the tendon carries
        long = 0.5
        return np.flatnonzero(self.levers >= long * self.levers.max())

    @property
    def characteristic_speed(self) -> float:
        """m/s, or rad/s over hinges."""
        return max(self.levers[j] * self._speed(j) for j in np.flatnonzero(self.levers))

    def _speed(self, joint: int) -> float:
        return min(characteristic_speed(self.model, joint), self._speeds.get(joint, np.inf))

    def unit(self, long: str, turned: str) -> str:
        """The unit of a quantity of this tendon, whose length is `long` in m, and over hinges alone may be rad."""
        joints = self.model.jnt_type[np.flatnonzero(self.levers)]
        return f"{long} or {turned}" if self._is_fixed and (joints == HINGE).all() else long

    @property
    def _is_fixed(self) -> bool:
        return int(wraps(self.model, self.tendon)[0]) == int(mujoco.mjtWrap.mjWRAP_JOINT)


def moving_dofs(model: mujoco.MjModel, tendon: int) -> np.ndarray:
    """The degrees of freedom that change the tendon's length somewhere in the range of its joints."""
    _, levers = _moved(model, _boxes(model, {}))
    return np.flatnonzero(levers[:, tendon] > TAUT)


def wraps(model: mujoco.MjModel, tendon: int) -> np.ndarray:
    """What the tendon's path is made of: of mjtWrap, (element,)."""
    first = model.tendon_adr[tendon]
    return model.wrap_type[first : first + model.tendon_num[tendon]]


def _boxes(model: mujoco.MjModel, seen: dict[int, JointMotion]) -> tuple[tuple[float, float], ...]:
    """From where to where each joint goes, m or rad: in the log, or else in its range."""
    boxes = []
    for joint in range(model.njnt):
        at, half = float(model.qpos0[model.jnt_qposadr[joint]]), travel(model, joint)
        if joint in seen:
            boxes.append((seen[joint].low, seen[joint].high))
        elif model.jnt_limited[joint]:
            boxes.append(tuple(model.jnt_range[joint].tolist()))
        else:
            boxes.append((at - half, at + half))
    return tuple(boxes)


@lru_cache(maxsize=64)
def _moved(model: mujoco.MjModel, boxes: tuple[tuple[float, float], ...]) -> tuple[np.ndarray, np.ndarray]:
    """The shortest and longest length of each tendon, (2, tendon), and its largest levers, (dof, tendon), without sign,
    where hinges and slides are inside the boxes.
    """
    data, generator = mujoco.MjData(model), np.random.default_rng(0)
    scalar = np.flatnonzero(np.isin(model.jnt_type, (HINGE, SLIDE)))
    low, high = np.array(boxes).T[:, scalar] if len(scalar) else np.zeros((2, 0))
    lengths, levers = [], np.zeros((model.nv, model.ntendon))
    places = 128  # drawn from where the joints go, at which lengths and levers are looked up
    for share in [None, *generator.random((places, len(scalar)))]:
        data.qpos[:] = model.qpos0
        if share is not None:
            data.qpos[model.jnt_qposadr[scalar]] = low + share * (high - low)
        mujoco.mj_fwdPosition(model, data)
        lengths.append(data.ten_length.copy())
        np.maximum(levers, np.abs(_jacobian(model, data)).T, out=levers)
    return np.stack([np.min(lengths, axis=0), np.max(lengths, axis=0)]), levers


def _jacobian(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Of the lengths of tendons, (tendon, dof)."""
    dense = np.zeros((model.ntendon, model.nv))
    mujoco.mju_sparse2dense(dense, data.ten_J, model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind)
    return dense
