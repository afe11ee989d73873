"""Friction that builds up over a distance before it slips: wires and tendons in sheaths, rubber, gears, flexures."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._joint_force import ForceOfKernel, JointForce
from capture_cli.effects._scales import free_inertia
from capture_cli.parameters import Parameter

SHORTEST, LONGEST = (
    0.01,
    1.0,
)  # of half of how far the joint goes: what is shorter is dry friction, longer a spring
STEPS = 4.0  # h w at most, squared and inverted, of the joint on the spring that the friction is while it builds up


class Dahl:
    """Friction -`friction` z, which after every turn comes back over the `distance`: dz/dx = (1 - z sgn v) / distance.

    The Dahl model (Dahl, A solid friction model, The Aerospace Corporation TOR-0158(3107-18)-1, 1968, with exponent 1),
    exact over a step of constant speed. wound: z at the start, within 1.
    """

    def __init__(self, *, friction, distance, timestep, wound=0.0):
        self.friction, self.distance, self.timestep = friction, distance, timestep
        self.z = np.clip(wound + 0.0 * friction, -1.0, 1.0)

    def __call__(self, qvel):
        """The friction at the end of the step."""
        toward = np.sign(qvel)
        self.z = toward + (self.z - toward) * np.exp(-np.abs(qvel) * self.timestep / self.distance)
        return -self.friction * self.z


class HystereticFriction(JointForce):
    """`friction` (N or N m) that comes back after a turn, the other way, over the `distance` (m or rad).

    Over a small part of the distance it is a spring, of friction / distance; over much more of it, dry friction.
    """

    summary = "friction that builds up over a distance: a tendon in its sheath, rubber, a cable, gears before they slip"
    shapes = ("distance",)
    vague_at_end = ("distance",)
    states = ("wound",)
    kernel = Dahl

    @property
    def parameters(self):
        most, travel = self.characteristic_force, self.characteristic_travel
        stable = STEPS * most * self.model.opt.timestep**2 / free_inertia(self.model, self.joint)
        shortest = max(SHORTEST * travel, stable)
        longest = max(LONGEST * travel, 4 * shortest)
        return (
            Parameter("friction", self.unit("N", "N m"), 0.0, most, 0.0),
            Parameter("distance", self.unit("m", "rad"), shortest, longest, np.sqrt(shortest * longest)),
        )

    def force(self, values, timestep, *, states=None, **_):
        wound = np.zeros(len(values)) if states is None else states[:, 0]
        return ForceOfKernel(self, self.coefficients(values) | {"wound": wound}, timestep)
