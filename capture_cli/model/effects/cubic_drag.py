"""Drag in proportion to the cube of speed: the cubic term of MuJoCo's damping polynomial."""

from __future__ import annotations

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects.base import raised


class CubicDrag(JointEffect):
    """`drag` c of the joint force -c v^3 is added to the model's."""

    place = "model"
    summary = "drag in proportion to speed cubed on a joint"

    @property
    def parameters(self):
        own = float(self.model.dof_dampingpoly[self.dof, 1])
        high = 2 * self.characteristic_force / self.characteristic_speed**3
        return (self.added("drag", self.unit("N s^3/m^3", "N m s^3/rad^3"), own, high),)

    def write(self, fields, values):
        polynomial = fields["dof_dampingpoly"]
        polynomial[:, self.dof, 1] = raised(polynomial[:, self.dof, 1], values[:, 0])
