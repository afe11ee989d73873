"""A spring along a tendon: MuJoCo's stiffness of it, and the length at which it is at rest."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._places import site_id
from capture_cli.effects._tendon_effect import TendonEffect
from capture_cli.parameters import Parameter

STIFFEST = 5.0  # times what is characteristic of the tendon, over half of how far its length goes
FARTHEST = 2.0  # of that half, beyond what is reached: where a spring that only ever pulls one way is at rest
LEAST = 1e-3  # of a length of 1: of how far it goes, at least


class TendonSpring(TendonEffect):
    """A spring of `stiffness` (N/m, or N m/rad over hinges) that is at rest where the tendon is `rest` long (m or rad).

    Beside a spring of the tendon's own the two are one, of the stiffness of both, at rest in between.
    """

    summary = "a spring along a tendon: a rubber band, a return spring, a hose beside a cylinder"
    where = (
        "every tendon that a hinge or slide joint moves, but those whose spring hardens, softens or has play"
    )
    shapes = ("rest",)

    @classmethod
    def sites(cls, model):
        return [s for s in super().sites(model) if _is_plain(model, site_id(model, "tendon", s))]

    @property
    def parameters(self):
        shortest, longest = self.reach
        half = max((longest - shortest) / 2, LEAST)
        high = STIFFEST * self.characteristic_force / half
        return (
            self.added(
                "stiffness",
                self.unit("N/m", "N m/rad"),
                float(self.model.tendon_stiffness[self.tendon]),
                high,
            ),
            Parameter(
                "rest",
                self.unit("m", "rad"),
                shortest - FARTHEST * half,
                longest + FARTHEST * half,
                (shortest + longest) / 2,
            ),
        )

    def write(self, fields, values):
        own, added = fields["tendon_stiffness"][:, self.tendon], values[:, 0]
        rest = fields["tendon_lengthspring"][:, self.tendon]
        both = own + added
        share = np.divide(added, both, out=np.zeros_like(both), where=both != 0)
        fields["tendon_lengthspring"][:, self.tendon] = rest + (share * (values[:, 1] - rest[:, 0]))[:, None]
        fields["tendon_stiffness"][:, self.tendon] = both


def _is_plain(model, tendon: int) -> bool:
    """Whether it has no spring, or one that is as stiff everywhere and at rest at one length."""
    at_rest = model.tendon_lengthspring[tendon]
    has_play = model.tendon_stiffness[tendon] > 0 and at_rest[0] != at_rest[1]
    return not (has_play or model.tendon_stiffnesspoly[tendon].any())
