"""Friction that builds up over a distance before it slips: wires and tendons in sheaths, rubber, gears, flexures."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._joint_force import JointForce
from capture_cli.effects._scales import free_inertia
from capture_cli.parameters import Parameter

# Of half of how far the joint goes: what is shorter is dry friction, what is longer a spring
SHORTEST, LONGEST = 0.01, 1.0
PASSED = (
    0.2  # of how far it goes in a window at its fastest: how a longer one begins would count for all of it
)
STEPS = 4.0  # h w at most, squared and inverted, of the joint on the spring that the friction is while it builds up


class Dahl:
    """Friction -`friction` z, which after every turn comes back over the `distance`: dz/dx = (1 - z sgn v) / distance.

    The Dahl model (Dahl, A solid friction model, The Aerospace Corporation TOR-0158(3107-18)-1, 1968, with exponent 1),
    exact over a step of constant speed. What moves at the start has been moving for long: z is 1 there.
    """

    def __init__(self, *, friction, distance, timestep):
        self.friction, self.distance, self.timestep = friction, distance, timestep
        self.z = None

    def __call__(self, qvel):
        """The friction at the end of the step."""
        toward = np.sign(qvel)
        if self.z is None:
            self.z = toward
        self.z = toward + (self.z - toward) * np.exp(-np.abs(qvel) * self.timestep / self.distance)
        return -self.friction * self.z


class HystereticFriction(JointForce):
    """`friction` (N or N m) that comes back after a turn, the other way, over the `distance` (m or rad).

    Over a small part of the distance it is a spring, of friction / distance; over much more of it, dry friction.
    """

    summary = "friction that builds up over a distance: a tendon in its sheath, rubber, a cable, gears before they slip"
    shapes = ("distance",)
    vague_at_end = ("distance",)
    kernel = Dahl

    @property
    def parameters(self):
        most, travel = self.characteristic_force, self.characteristic_travel
        if self.window and self.seen:
            travel = min(travel, PASSED * self.seen.speed * self.window)
        stable = STEPS * most * self.model.opt.timestep**2 / free_inertia(self.model, self.joint)
        shortest = max(SHORTEST * travel, stable)
        longest = max(LONGEST * travel, 4 * shortest)
        return (
            Parameter("friction", self.unit("N", "N m"), 0.0, most, 0.0),
            Parameter("distance", self.unit("m", "rad"), shortest, longest, np.sqrt(shortest * longest)),
        )
