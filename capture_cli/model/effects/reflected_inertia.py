"""Inertia of a rotor seen through its gear: MuJoCo's armature."""

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects._raised import Raised


class ReflectedInertia(Raised, JointEffect):
    """`armature` (kg or kg m^2) is added to the joint's."""

    summary = "inertia of a motor's rotor, seen through its gear, at a joint"
    field = "dof_armature"

    @property
    def parameters(self):
        return self.added("armature", self.unit("kg", "kg m^2"), 2 * self.inertia)
