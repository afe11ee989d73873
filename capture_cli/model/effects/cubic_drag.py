"""Drag in proportion to the cube of speed: the cubic term of MuJoCo's damping polynomial."""

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects._raised import Raised


class CubicDrag(Raised, JointEffect):
    """`drag` c of the joint force -c v^3 is added to the model's."""

    summary = "drag in proportion to speed cubed on a joint"
    field = "dof_dampingpoly"
    term = (1,)

    @property
    def parameters(self):
        high = 2 * self.characteristic_force / self.characteristic_speed**3
        return self.added("drag", self.unit("N s^3/m^3", "N m s^3/rad^3"), high)
