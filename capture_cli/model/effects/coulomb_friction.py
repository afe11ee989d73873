"""Dry friction of constant size: MuJoCo's frictionloss."""

from __future__ import annotations

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects.base import raised


class CoulombFriction(JointEffect):
    """`friction` (N or N m) is added to the joint's frictionloss."""

    place = "model"
    summary = "dry friction of constant size in a joint"

    @property
    def parameters(self):
        own = float(self.model.dof_frictionloss[self.dof])
        return (self.added("friction", self.unit("N", "N m"), own, self.characteristic_force),)

    def write(self, fields, values):
        friction = fields["dof_frictionloss"]
        friction[:, self.dof] = raised(friction[:, self.dof], values[:, 0])
