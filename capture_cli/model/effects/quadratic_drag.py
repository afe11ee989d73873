"""Drag in proportion to the square of speed: the quadratic term of MuJoCo's damping polynomial."""

from __future__ import annotations

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects.base import raised


class QuadraticDrag(JointEffect):
    """`drag` b of the joint force -b v|v| is added to the model's."""

    place = "model"
    summary = "drag in proportion to speed squared on a joint, as of air"

    @property
    def parameters(self):
        own = float(self.model.dof_dampingpoly[self.dof, 0])
        high = 2 * self.characteristic_force / self.characteristic_speed**2
        return (self.added("drag", self.unit("N s^2/m^2", "N m s^2/rad^2"), own, high),)

    def write(self, fields, values):
        polynomial = fields["dof_dampingpoly"]
        polynomial[:, self.dof, 0] = raised(polynomial[:, self.dof, 0], values[:, 0])
