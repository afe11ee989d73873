"""Dry friction along a tendon: MuJoCo's frictionloss of it."""

from __future__ import annotations

from capture_cli.model.effects._tendon_effect import TendonEffect
from capture_cli.model.effects.base import raised


class TendonFriction(TendonEffect):
    """`friction` (N, or N m over hinges) is added to the tendon's frictionloss: it holds all joints that the tendon
    couples at once, each by its lever.
    """

    summary = (
        "dry friction along a tendon: a rope on its sheaves, a cable in its sheath, the seal of a cylinder"
    )

    @property
    def parameters(self):
        own = float(self.model.tendon_frictionloss[self.tendon])
        return (self.added("friction", self.unit("N", "N m"), own, self.characteristic_force),)

    def write(self, fields, values):
        friction = fields["tendon_frictionloss"]
        friction[:, self.tendon] = raised(friction[:, self.tendon], values[:, 0])
