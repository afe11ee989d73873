"""How a body can turn: about one axis alone, along which nothing that is fixed to it shows where it sits."""

import mujoco
import numpy as np

from capture_cli.model.effects._scales import HINGE, SLIDE, box_edges

PARALLEL = 1 - 1e-6


def turning_joints(model: mujoco.MjModel, body: int) -> list[int]:
    """Joints that turn the body: its own and those of the bodies it hangs on."""
    joints = []
    while body:
        first = model.body_jntadr[body]
        joints += range(first, first + model.body_jntnum[body])
        body = int(model.body_parentid[body])
    return [j for j in joints if model.jnt_type[j] != SLIDE]


def axes_that_show(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Which axes (axis,) of the body's frame are not the one that it can turn about, where there is only one."""
    axis = _only_axis(model, body)
    along = np.zeros(3) if axis is None else np.abs(axis)
    return np.flatnonzero(along < PARALLEL)


def reach(model: mujoco.MjModel, body: int, position: np.ndarray) -> float:
    """m: how large the body is, or how far from its frame `position` (3,) is, if that is more."""
    return max(float(np.max(box_edges(model, body))), float(np.linalg.norm(position)))


def _only_axis(model: mujoco.MjModel, body: int) -> np.ndarray | None:
    """The axis (3,), in the body's frame, that all its hinges share; None where it can turn otherwise."""
    joints = turning_joints(model, body)
    if any(model.jnt_type[j] != HINGE for j in joints):
        return None
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    axes = data.xaxis[joints]
    if (np.abs(axes @ axes[0]) < PARALLEL).any():
        return None
    return data.xmat[body].reshape(3, 3).T @ axes[0]
