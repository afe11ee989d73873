"""A spring over two joints: a hose, a bundle of cables, an elastic tendon."""

import mujoco

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects._kernel import Companion, call
from capture_cli.model.effects._neighbours import joint_before
from capture_cli.model.effects._places import source
from capture_cli.model.effects._scales import HINGE, SLIDE, travel
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.object_names import object_name
from capture_cli.model.parameters import Parameter


def pull(position, before, *, stiffness, ratio, rest):
    """The force -stiffness (position + ratio before - rest)."""
    return -stiffness * (position + ratio * before - rest)


class CoupledSpring(JointEffect):
    """A spring of `stiffness` k (N/m or N m/rad) over this joint, at q, and the one before it, at p: the force
    -k (q + `ratio` p - `rest`) here, and `ratio` times as much there.

    So does a hose that runs over both, or a tendon over two pulleys: what moves one joint pulls at the other, which
    springs at each of them do not.
    """

    place = "force"
    summary = "a spring over two joints that follow each other: a hose, a bundle of cables, an elastic tendon"
    where = "every hinge and slide joint that hangs on another"
    shapes = ("ratio", "rest")

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self._joints = self.joint, joint_before(model, self.joint)
        self._seen = [None, None]

    @classmethod
    def sites(cls, model):
        scalar = (j for j in range(model.njnt) if model.jnt_type[j] in (HINGE, SLIDE))
        return [object_name(model, "joint", j) for j in scalar if joint_before(model, j) >= 0]

    def look_in(self, log):
        super().look_in(log)
        self._seen = [log.seen.get(j) for j in self._joints]

    @property
    def parameters(self):
        turns = self.model.jnt_type[self._joints[1]] == HINGE
        unit = "1" if turns == self.is_hinge else "m" if turns else "1/m"
        here, there = (self._farthest(k) for k in range(2))
        most = 2.0  # levers of joints that follow each other are about as long
        if turns != self.is_hinge:
            most *= here / there
        # times what is characteristic of the joint, in N or N m, where it is farthest from 0
        stiffest = 5.0 * self.characteristic_force / here
        return (
            Parameter("stiffness", self.unit("N/m", "N m/rad"), 0.0, stiffest, 0.0),
            Parameter("ratio", unit, -most, most, most / 2),
            Parameter("rest", self.unit("m", "rad"), -2 * here, 2 * here, 0.0),
        )

    def _farthest(self, which: int) -> float:
        """m or rad: how far from 0 the joint (0), or the one before it (1), goes in the log, or else its travel."""
        seen, joint = self._seen[which], self._joints[which]
        return max(abs(seen.low), abs(seen.high)) if seen else travel(self.model, joint)

    def force(self, values, timestep, **_):
        at, before = (int(self.model.jnt_qposadr[j]) for j in self._joints)
        dof = int(self.model.jnt_dofadr[self._joints[1]])
        given = self.coefficients(values)

        def force(world):
            own = {name: v[world.rows] for name, v in given.items()}
            term = pull(world.qpos[:, at], world.qpos[:, before], **own)
            world.qfrc_applied[:, self.dof] += term
            world.qfrc_applied[:, dof] += own["ratio"] * term

        return force

    def companion(self, name, values):
        numbers = self.numbers(values)
        names = (object_name(self.model, "joint", j) for j in self._joints)
        own, before = (source(self.model, "joint", name) for name in names)
        given = [f"data.qpos[{joint}.qposadr]" for joint in (own, before)]
        term, _ = call(name, pull, given, numbers)
        lines = (
            f"term = {term}",
            f"data.qfrc_applied[{own}.dofadr] += term",
            f"data.qfrc_applied[{before}.dofadr] += {float(numbers['ratio'])!r} * term",
        )
        return Companion((pull,), lines, changes=("data.qfrc_applied",))
