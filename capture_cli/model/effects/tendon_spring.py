"""A spring along a tendon: MuJoCo's stiffness of it, and the length at which it is at rest."""

from capture_cli.model.effects._side_by_side import side_by_side
from capture_cli.model.effects._tendon_effect import TendonEffect
from capture_cli.model.parameters import Parameter


class TendonSpring(TendonEffect):
    """A spring of `stiffness` (N/m, or N m/rad over hinges) that is at rest where the tendon is `rest` long (m or rad).

    Beside a spring of the tendon's own the two are one, of the stiffness of both, at rest in between.
    """

    summary = "a spring along a tendon: a rubber band, a return spring, a hose beside a cylinder"
    where = "every tendon that hinges and slides move, but those whose spring hardens, softens or has play"
    shapes = ("rest",)

    @classmethod
    def suits(cls, model, tendon):
        at_rest = model.tendon_lengthspring[tendon]
        has_play = model.tendon_stiffness[tendon] > 0 and at_rest[0] != at_rest[1]
        return super().suits(model, tendon) and not (has_play or model.tendon_stiffnesspoly[tendon].any())

    @property
    def parameters(self):
        least = 1e-3  # of a length of 1: of how far it goes, at least
        half = max((self.longest - self.shortest) / 2, least)
        own = float(self.model.tendon_stiffness[self.tendon])
        stiffest = 5.0  # times what is characteristic of the tendon, over half of how far its length goes
        high = stiffest * self.characteristic_force / half
        # of that half, beyond what is reached: where a spring that only ever pulls one way is at rest
        farthest = 2.0
        near, far = self.shortest - farthest * half, self.longest + farthest * half
        return (
            Parameter("stiffness", self.unit("N/m", "N m/rad"), min(0.0, -own), high, 0.0),
            Parameter("rest", self.unit("m", "rad"), near, far, (self.shortest + self.longest) / 2),
        )

    def write(self, fields, values):
        stiffness = fields["tendon_stiffness"][:, self.tendon, None]
        rest = fields["tendon_lengthspring"][:, self.tendon]  # (simulation, 2): from where to where it is
        stiffness[:], rest[:] = side_by_side(stiffness, rest, values[:, :1], values[:, 1:])
