"""Friction along a tendon in proportion to its speed: MuJoCo's damping of it."""

from __future__ import annotations

from capture_cli.model.effects._tendon_effect import TendonEffect
from capture_cli.model.effects.base import raised


class TendonDamping(TendonEffect):
    """`damping` (N s/m, or N m s/rad over hinges) is added to the tendon's: of what its joints do together, and not of
    what each does.
    """

    summary = (
        "friction along a tendon in proportion to its speed: oil in a cylinder, a clutch between two shafts"
    )

    @property
    def parameters(self):
        own = float(self.model.tendon_damping[self.tendon])
        high = 2 * self.characteristic_force / self.characteristic_speed
        return (self.added("damping", self.unit("N s/m", "N m s/rad"), own, high),)

    def write(self, fields, values):
        damping = fields["tendon_damping"]
        damping[:, self.tendon] = raised(damping[:, self.tendon], values[:, 0])
