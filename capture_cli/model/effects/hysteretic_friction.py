"""Dry friction that builds up over a distance: pre-sliding, a harmonic drive, a seal, a cable over pulleys."""

import numpy as np

from capture_cli.log.turning_points import WaysBefore
from capture_cli.model.effects._followed_force import Begins, FollowedForce
from capture_cli.model.effects._followed_log import at_steps, without_gaps
from capture_cli.model.effects._joint_force import ForceOfKernel
from capture_cli.model.effects._scales import SETTINGS as SCALES
from capture_cli.model.effects._scales import free_inertia
from capture_cli.model.parameters import Parameter


class Bristles:
    """The force -friction z of bristles that bend by z, -1 to 1, and slip: distance dz/dx = 1 - sign(dx) z.

    Dahl, A solid friction model, 1968, with exponent 1: exact over any way in one direction. wound: z at the start.
    """

    def __init__(self, *, friction, distance, timestep, wound=0.0):
        self.friction, self.distance, self.timestep = friction, distance, timestep
        self.wound = wound + 0.0 * friction

    def __call__(self, qvel):
        self.move(self.timestep * qvel)
        return -self.friction * self.wound

    def move(self, way):
        """Bend the bristles by a way (m or rad) in one direction."""
        side = np.sign(way)
        self.wound = side + (self.wound - side) * np.exp(-np.abs(way) / self.distance)


class HystereticFriction(FollowedForce):
    """Dry friction of size `friction` (N or N m) that a joint has to move about `distance` (m or rad) to build up, and
    as far to turn: over less than that it is a spring.

    How far it is wound up when a window begins follows from where the joint went before, which the log has to measure,
    and, until it has gone far enough, from how far it was when the episode began, or went on after a gap, which nobody
    knows. A simulation that begins otherwise begins with nothing wound up.
    """

    summary = "dry friction that builds up over a distance: pre-sliding, hysteresis of a drive"
    where = "every hinge and slide joint whose position is measured"
    shapes = ("distance",)
    # beside what follows from the way, as much as the noise hides of that; and all of it before any way was gone
    states = ("wound", "wound_before")
    states_mean = (
        "`wound`: by how much it is wound up beyond what follows from the way in the log; at 1 by two standard "
        "deviations of the noise on the position (m or rad) over `distance`. `wound_before`: how far it was wound up "
        "when the episode began, from -1 to 1. In the module `wound` is how far it is"
    )
    kernel = Bristles
    kernel_keeps = ("wound",)

    @property
    def parameters(self):
        reach = self.characteristic_travel
        moved = free_inertia(self.model, self.joint)
        stiff = self.characteristic_force * (self.model.opt.timestep / SCALES.stiffest) ** 2 / moved
        shortest, longest = min(max(1e-4 * reach, stiff), 0.1 * reach), 0.5 * reach
        return (
            Parameter("friction", self.unit("N", "N m"), 0.0, self.characteristic_force, 0.0),
            Parameter("distance", self.unit("m", "rad"), shortest, longest, max(0.05 * reach, 2 * shortest)),
        )

    def look_in(self, log):
        super().look_in(log)
        turned = 4.0  # times the noise of what measures the joint: less is no way back
        if self.seen is not None:
            self._path = without_gaps(self.seen.time, self.seen.path, self.seen.stretches)
            self._ways_before = WaysBefore(self.seen.path, self.seen.stretches, turned * self.seen.noise)

    def force_since(self, given, timestep, begins):
        return ForceWoundUpToHere(self, given | {"wound": self._wound(given, begins)}, timestep)

    def states_sd(self, first):
        if self.seen is None:
            return super().states_sd(first)
        longest = self.space.high[self.space.names.index("distance")]
        ways = self._ways_before(first)
        matters = super().states_sd(first)
        # times the distance that friction takes to build up: then nothing is left of what was before
        forgotten = 5.0
        matters[:, 1] = _reaches_back(ways) & (np.abs(ways).sum(axis=1) < forgotten * longest)
        return matters

    def _wound(self, given: dict[str, np.ndarray], begins: Begins) -> np.ndarray:
        """How far simulations are wound up where they begin, (simulation,)."""
        friction, distance = given["friction"], given["distance"]
        last = begins.shown.astype(int)
        ways = self._ways_before(last)
        before = np.clip(begins.states[:, 1], -1, 1) * _reaches_back(ways)
        bristles = Bristles(friction=friction, distance=distance, timestep=0.0, wound=before)
        for way in ways.T:
            bristles.move(way)
        bristles.move(at_steps(self._path, begins.shown) - self._path[last])
        hides = 2.0  # times the noise of what measures the joint: of the way, what nobody knows when a window begins
        hidden = hides * self.seen.noise * begins.states[:, 0]  # m or rad
        return np.clip(bristles.wound + hidden / distance, -1, 1)


class ForceWoundUpToHere(ForceOfKernel):
    """That of bristles wound up by the way to where a simulation begins: its first call has no way left to go."""

    def kernel_in(self, world):
        begins = self.begins_in(world)
        bristles = super().kernel_in(world)
        bristles.timestep = 0.0 if begins else self.timestep
        return bristles


def _reaches_back(ways: np.ndarray) -> np.ndarray:
    """Whether ways (simulation, way) are all since the beginning: where as many as are remembered, not."""
    return ways[:, 0] == 0
