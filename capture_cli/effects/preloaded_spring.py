"""A spring at a joint that is at rest somewhere else: MuJoCo's joint stiffness and springref."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._joint_effect import SpringEffect
from capture_cli.parameters import Parameter

FARTHEST = 2.0  # of the joint's travel: where a spring that only ever pulls one way is at rest
PUSHES = 0.2  # of the stiffest spring: the most that one pushes away from where it rests


class PreloadedSpring(SpringEffect):
    """A spring of `stiffness` (N/m or N m/rad) that is at rest at the joint position `rest` (m or rad).

    Below zero it pushes away from there: ropes whose weight changes sides, magnets, a balance that does too much.
    Beside a spring of the joint's own the two are one, of the stiffness of both, at rest in between.
    """

    summary = "a spring that rests elsewhere than the joint's own, or pushes away: a harness, ropes that shift weight"
    where = "every hinge and slide joint, but those whose spring hardens or softens"
    shapes = ("rest",)

    @classmethod
    def suits(cls, model, joint):
        return not model.jnt_stiffnesspoly[joint].any()

    @property
    def parameters(self):
        high = 5 * self.characteristic_force / self.travel
        far = abs(self.middle) + FARTHEST * max(self.travel, self.reach)
        return (
            Parameter("stiffness", self.unit("N/m", "N m/rad"), -PUSHES * high, high, 0.0),
            Parameter("rest", self.unit("m", "rad"), -far, far, 0.0),
        )

    def write(self, fields, values):
        own, added = fields["jnt_stiffness"][:, self.joint], values[:, 0]
        rest = fields["qpos_spring"][:, self.position]
        both = own + added
        shift = np.divide(added * (values[:, 1] - rest), both, out=np.zeros_like(both), where=both != 0)
        fields["qpos_spring"][:, self.position] = rest + shift
        fields["jnt_stiffness"][:, self.joint] = both
