"""Inertia of a rotor seen through its gear: MuJoCo's armature."""

from __future__ import annotations

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects.base import raised


class ReflectedInertia(JointEffect):
    """`armature` (kg or kg m^2) is added to the joint's."""

    place = "model"
    summary = "inertia of a motor's rotor, seen through its gear, at a joint"

    @property
    def parameters(self):
        own = float(self.model.dof_armature[self.dof])
        return (self.added("armature", self.unit("kg", "kg m^2"), own, 2 * self.inertia),)

    def write(self, fields, values):
        armature = fields["dof_armature"]
        armature[:, self.dof] = raised(armature[:, self.dof], values[:, 0])
