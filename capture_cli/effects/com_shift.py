"""A centre of mass that lies elsewhere than modelled."""

from __future__ import annotations

import mujoco
import numpy as np

from capture_cli.effects._places import site_id
from capture_cli.effects._scales import HINGE, SLIDE, box_edges, moving_bodies
from capture_cli.effects.base import GLOBAL, Effect
from capture_cli.parameters import Parameter
from capture_cli.sim.object_names import object_name

PARALLEL = 1 - 1e-6


class ComShift(Effect):
    """Shift (m) of a body's centre of mass along the axes of the body's frame; the mass stays as it is.

    A shift along the only axis that the body can turn about moves nothing, and is left out. So are bodies
    that no joint turns, and bodies that were compiled as `simple`, whose centre MuJoCo cannot move; those of
    a task never are.
    """

    place = "model"
    summary = "a body's centre of mass lies elsewhere than modelled"
    where = "every body with mass that some joint can turn"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.body = site_id(model, "body", site)
        axis = _only_axis(model, self.body)
        along = np.zeros(3) if axis is None else np.abs(axis)
        self.axes = np.flatnonzero(along < PARALLEL)

    @classmethod
    def sites(cls, model):
        turned = (b for b in moving_bodies(model) if not model.body_simple[b] and _rotations(model, b))
        return [object_name(model, "body", b) for b in turned]

    @property
    def parameters(self):
        size = float(np.max(box_edges(self.model, self.body)))
        reach = max(size, float(np.linalg.norm(self.model.body_ipos[self.body]))) / 2
        return tuple(Parameter("xyz"[i], "m", -reach, reach, 0.0) for i in self.axes)

    def write(self, fields, values):
        fields["body_ipos"][:, self.body, self.axes] += values


def _rotations(model: mujoco.MjModel, body: int) -> list[int]:
    """Joints that turn the body: its own and those of the bodies it hangs on."""
    joints = []
    while body:
        first = model.body_jntadr[body]
        joints += range(first, first + model.body_jntnum[body])
        body = int(model.body_parentid[body])
    return [j for j in joints if model.jnt_type[j] != SLIDE]


def _only_axis(model: mujoco.MjModel, body: int) -> np.ndarray | None:
    """The axis (3,), in the body's frame, that all its hinges share; None where it can turn otherwise."""
    joints = _rotations(model, body)
    if any(model.jnt_type[j] != HINGE for j in joints):
        return None
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    axes = data.xaxis[joints]
    if (np.abs(axes @ axes[0]) < PARALLEL).any():
        return None
    return data.xmat[body].reshape(3, 3).T @ axes[0]
