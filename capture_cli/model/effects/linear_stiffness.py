"""A spring at a joint: MuJoCo's joint stiffness."""

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects._raised import Raised


class LinearStiffness(Raised, JointEffect):
    """`stiffness` (N/m or N m/rad) is added to the joint's; the spring rests at the joint's springref."""

    summary = "a spring at a joint: a cable, a hose, a flexure"
    field = "jnt_stiffness"

    @property
    def parameters(self):
        high = 5 * self.characteristic_force / self.characteristic_travel
        return self.added("stiffness", self.unit("N/m", "N m/rad"), high)
