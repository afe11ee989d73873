"""A spring at a joint that is at rest somewhere else: MuJoCo's joint stiffness and springref."""

import numpy as np

from capture_cli.model.effects._joint_effect import SpringEffect
from capture_cli.model.effects._side_by_side import side_by_side
from capture_cli.model.parameters import Parameter


class PreloadedSpring(SpringEffect):
    """A spring of `stiffness` (N/m or N m/rad) that is at rest at the joint position `rest` (m or rad).

    Below zero it pushes away from there: ropes whose weight changes sides, magnets, a balance that does too much.
    Beside a spring of the joint's own the two are one, of the stiffness of both, at rest in between.
    """

    summary = "a spring that rests elsewhere than the joint's own, or pushes away: a harness, ropes that shift weight"
    where = "every hinge and slide joint, but those whose spring hardens or softens"
    shapes = ("rest",)
    mixes = True

    @classmethod
    def suits(cls, model, joint):
        return not model.jnt_stiffnesspoly[joint].any()

    @property
    def parameters(self):
        high = 5 * self.characteristic_force / self.characteristic_travel
        # of the joint's travel: where a spring that only ever pulls one way is at rest; in a log farther, to where it
        # pulls within a tenth as it does in the middle, and is hardly told from a constant force
        farthest = 10.0 if self.seen else 2.0
        far = abs(self.middle) + farthest * max(self.travel, self.reach)
        pushes = 0.2  # of the stiffest spring: the most that one pushes away from where it rests
        return (
            Parameter("stiffness", self.unit("N/m", "N m/rad"), -pushes * high, high, 0.0),
            Parameter("rest", self.unit("m", "rad"), -far, far, 0.0),
        )

    def mixture(self, shapes, amplitudes):
        """Springs side by side are one of all their stiffness, at rest where their forces are in balance, if anywhere
        within reach.
        """
        space, stiffness = self.space, amplitudes.sum()
        rest = amplitudes @ shapes[:, 1] / stiffness if stiffness else np.inf
        if not space.low[1] <= rest <= space.high[1]:
            return None
        return np.array([stiffness * space.span[0], rest])

    def write(self, fields, values):
        stiffness, rest = fields["jnt_stiffness"][:, self.joint], fields["qpos_spring"][:, self.position]
        stiffness[:], rest[:] = side_by_side(stiffness, rest, values[:, 0], values[:, 1])
