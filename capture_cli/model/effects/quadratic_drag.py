"""Drag in proportion to the square of speed: the quadratic term of MuJoCo's damping polynomial."""

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects._raised import Raised


class QuadraticDrag(Raised, JointEffect):
    """`drag` b of the joint force -b v|v| is added to the model's."""

    summary = "drag in proportion to speed squared on a joint, as of air"
    field = "dof_dampingpoly"
    term = (0,)

    @property
    def parameters(self):
        high = 2 * self.characteristic_force / self.characteristic_speed**2
        return self.added("drag", self.unit("N s^2/m^2", "N m s^2/rad^2"), high)
