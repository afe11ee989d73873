"""Friction in proportion to speed: MuJoCo's joint damping."""

from __future__ import annotations

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects.base import raised


class ViscousDamping(JointEffect):
    """`damping` (N s/m or N m s/rad) is added to the joint's."""

    place = "model"
    summary = "friction in proportion to speed in a joint"

    @property
    def parameters(self):
        own = float(self.model.dof_damping[self.dof])
        high = 2 * self.characteristic_force / self.characteristic_speed
        return (self.added("damping", self.unit("N s/m", "N m s/rad"), own, high),)

    def write(self, fields, values):
        damping = fields["dof_damping"]
        damping[:, self.dof] = raised(damping[:, self.dof], values[:, 0])
