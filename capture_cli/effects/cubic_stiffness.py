"""A spring that hardens or softens: the cubic term of MuJoCo's stiffness polynomial."""

from __future__ import annotations

from capture_cli.effects._joint_effect import JointEffect
from capture_cli.parameters import Parameter


class CubicStiffness(JointEffect):
    """`stiffness` c of the joint force -c x^3, with x the distance from springref, is added to the model's.

    Below zero the spring softens; the lower bound is where it no longer pulls back at the end of the joint's
    travel.
    """

    place = "model"
    summary = "a spring at a joint that hardens (or softens) with deflection"

    @property
    def parameters(self):
        own = float(self.model.jnt_stiffness[self.joint])
        high = 5 * self.characteristic_force / self.characteristic_travel**3
        return (
            Parameter(
                "stiffness",
                self.unit("N/m^3", "N m/rad^3"),
                min(0.0, -own) / self.characteristic_travel**2,
                high,
                0.0,
            ),
        )

    def write(self, fields, values):
        fields["jnt_stiffnesspoly"][:, self.joint, 1] += values[:, 0]
