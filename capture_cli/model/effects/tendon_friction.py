"""Dry friction along a tendon: MuJoCo's frictionloss of it."""

from capture_cli.model.effects._raised import Raised
from capture_cli.model.effects._tendon_effect import TendonEffect


class TendonFriction(Raised, TendonEffect):
    """`friction` (N, or N m over hinges) is added to the tendon's frictionloss: it holds all joints that the tendon
    couples at once, each by its lever.
    """

    summary = (
        "dry friction along a tendon: a rope on its sheaves, a cable in its sheath, the seal of a cylinder"
    )
    field = "tendon_frictionloss"

    @property
    def parameters(self):
        return self.added("friction", self.unit("N", "N m"), self.characteristic_force)
