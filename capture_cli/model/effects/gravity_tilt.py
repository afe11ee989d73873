"""Gravity of another direction: a machine or a table that does not stand level."""

import mujoco
import numpy as np

from capture_cli.model.effects._rotation import rotate
from capture_cli.model.effects.base import GLOBAL, Effect
from capture_cli.model.parameters import Parameter

AXES = "xyz"


class GravityTilt(Effect):
    """Angles (rad) by which gravity leans towards the world's axes that are most nearly horizontal.

    With gravity along -z, `tilt_x` is how far gravity leans towards +x: a ball on the level table of the
    model rolls that way. The second angle turns about an axis that the first has not moved.
    """

    place = "model"
    summary = "gravity leans: the machine does not stand level"
    where = "the model as a whole, where it has gravity"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        down = model.opt.gravity / np.linalg.norm(model.opt.gravity)
        self.towards = np.sort(np.argsort(np.abs(down), kind="stable")[:2])
        turns = np.cross(down, np.eye(3)[self.towards])
        self.axes = turns / np.linalg.norm(turns, axis=1, keepdims=True)

    @classmethod
    def sites(cls, model):
        return [GLOBAL] if model.opt.gravity.any() and model.nv else []

    @property
    def parameters(self):
        level = np.pi / 2  # then gravity points along the axis: beyond, the machine hangs
        return tuple(Parameter(f"tilt_{AXES[i]}", "rad", -level, level, 0.0) for i in self.towards)

    def write(self, fields, values):
        gravity = fields["opt.gravity"]
        for axis, angle in zip(self.axes, values.T, strict=True):
            gravity[...] = rotate(gravity, angle[:, None] * axis)
