"""Dry friction of constant size: MuJoCo's frictionloss."""

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects._raised import Raised


class CoulombFriction(Raised, JointEffect):
    """`friction` (N or N m) is added to the joint's frictionloss."""

    summary = "dry friction of constant size in a joint"
    field = "dof_frictionloss"

    @property
    def parameters(self):
        return self.added("friction", self.unit("N", "N m"), self.characteristic_force)
