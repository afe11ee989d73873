"""What moves along with a tendon: MuJoCo's armature of it."""

from __future__ import annotations

from capture_cli.effects._joint_effect import raised
from capture_cli.effects._tendon_effect import TendonEffect

MOST = 2.0  # times the inertia that the tendon moves


class TendonInertia(TendonEffect):
    """`armature` (kg, or kg m^2 over hinges) is added to the tendon's: what speeds up as its length does, and is felt
    by all joints that it couples, each by its lever.
    """

    summary = (
        "what speeds up along with a tendon: the drum that winds it up and its motor, a piston and its oil"
    )

    @property
    def parameters(self):
        own = float(self.model.tendon_armature[self.tendon])
        return (self.added("armature", self.unit("kg", "kg m^2"), own, MOST * self.inertia),)

    def write(self, fields, values):
        armature = fields["tendon_armature"]
        armature[:, self.tendon] = raised(armature[:, self.tendon], values[:, 0])
