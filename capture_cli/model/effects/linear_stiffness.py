"""A spring at a joint: MuJoCo's joint stiffness."""

from __future__ import annotations

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects.base import raised


class LinearStiffness(JointEffect):
    """`stiffness` (N/m or N m/rad) is added to the joint's; the spring rests at the joint's springref."""

    place = "model"
    summary = "a spring at a joint: a cable, a hose, a flexure"

    @property
    def parameters(self):
        own = float(self.model.jnt_stiffness[self.joint])
        high = 5 * self.characteristic_force / self.characteristic_travel
        return (self.added("stiffness", self.unit("N/m", "N m/rad"), own, high),)

    def write(self, fields, values):
        stiffness = fields["jnt_stiffness"]
        stiffness[:, self.joint] = raised(stiffness[:, self.joint], values[:, 0])
