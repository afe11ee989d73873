"""A spring that hardens or softens: the cubic term of MuJoCo's stiffness polynomial."""

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.parameters import Parameter


class CubicStiffness(JointEffect):
    """`stiffness` c of the joint force -c x^3, with x the distance from springref, is added to the model's.

    Below zero the spring softens; the lower bound is where it no longer pulls back at the end of the joint's
    travel, or as far from springref as the log goes.
    """

    place = "model"
    summary = "a spring at a joint that hardens (or softens) with deflection"

    @property
    def parameters(self):
        own, far = float(self.model.jnt_stiffness[self.joint]), self.farthest
        return (
            Parameter(
                "stiffness",
                self.unit("N/m^3", "N m/rad^3"),
                min(0.0, -own) / far**2,
                5 * self.characteristic_force / far**3,
                0.0,
            ),
        )

    @property
    def farthest(self) -> float:
        """m or rad: from where the spring is at rest, in the log, or else half of the joint's range."""
        if not self.seen:
            return self.travel
        rest = float(self.model.qpos_spring[self.model.jnt_qposadr[self.joint]])
        return max(self.seen.high - rest, rest - self.seen.low)

    def write(self, fields, values):
        fields["jnt_stiffnesspoly"][:, self.joint, 1] += values[:, 0]
