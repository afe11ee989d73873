"""Friction along a tendon in proportion to its speed: MuJoCo's damping of it."""

from capture_cli.model.effects._raised import Raised
from capture_cli.model.effects._tendon_effect import TendonEffect


class TendonDamping(Raised, TendonEffect):
    """`damping` (N s/m, or N m s/rad over hinges) is added to the tendon's: of what its joints do together, and not of
    what each does.
    """

    summary = (
        "friction along a tendon in proportion to its speed: oil in a cylinder, a clutch between two shafts"
    )
    field = "tendon_damping"

    @property
    def parameters(self):
        high = 2 * self.characteristic_force / self.characteristic_speed
        return self.added("damping", self.unit("N s/m", "N m s/rad"), high)
