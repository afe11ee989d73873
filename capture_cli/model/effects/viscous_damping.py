"""Friction in proportion to speed: MuJoCo's joint damping."""

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects._raised import Raised


class ViscousDamping(Raised, JointEffect):
    """`damping` (N s/m or N m s/rad) is added to the joint's."""

    summary = "friction in proportion to speed in a joint"
    field = "dof_damping"

    @property
    def parameters(self):
        high = 2 * self.characteristic_force / self.characteristic_speed
        return self.added("damping", self.unit("N s/m", "N m s/rad"), high)
