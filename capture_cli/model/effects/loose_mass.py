"""Something inside that is not fixed: a liquid that sloshes, a load that swings, a part on soft mounts."""

from __future__ import annotations

import numpy as np

from capture_cli.model.effects._joint_force import JointForce
from capture_cli.model.effects._scales import characteristic_force, free_inertia
from capture_cli.model.effects._two_mass import MOST_SHARE
from capture_cli.model.effects._vibration import ForceShakenBefore, Shaken, Vibration, VibrationEffect
from capture_cli.model.parameters import Parameter


class Oscillator(Vibration):
    """The force -m d'' on a joint, of whose inertia M the part m hangs on a spring and is d ahead of the rest.

    The model carries all of M rigidly. With a the joint's acceleration the loose part obeys
    m (a + d'') = -k d - c d', and all together M a = F - m d'', with F what the model knows of. Eliminating a,

        d'' (1 - m / M) + 2 zeta w d' + w^2 d = -b,   w^2 = k / m,   2 zeta w = c / m,

    b = a + (m / M) d'' being the acceleration without the extra force; b is that of the step before.
    """

    def __init__(self, *, mass, timestep, **rest):
        super().__init__(timestep=timestep, **rest)
        self.mass = mass
        self.extra, self.speed = 0.0 * mass, None  # the force of the last step, and the joint's speed there

    def __call__(self, qvel, qacc, inertia):
        """The force. qacc and inertia (M) are of the step before."""
        mass = np.minimum(self.mass, MOST_SHARE * inertia)
        rigid = qacc if self.speed is None else (qvel - self.speed) / self.timestep - self.extra / inertia
        self.extra, self.speed = -mass * self.advance(rigid, 1 - mass / inertia), np.array(qvel)
        return self.extra


class LooseMass(VibrationEffect, JointForce):
    """Of what the joint moves, `mass` (kg or kg m^2) hangs on a spring along it: it swings at `frequency` (Hz) where
    the joint is held, and `damping_ratio` is of the critical damping.

    The declared inertia holds it: with nothing loose, all of it is rigid.
    """

    summary = "something inside that is not fixed: a liquid that sloshes, a load that swings"
    reads_acceleration = True
    kernel = Oscillator

    @property
    def total(self) -> float:
        """kg or kg m^2: what a force on the joint accelerates."""
        return free_inertia(self.model, self.joint)

    @property
    def parameters(self):
        most = 0.8  # of what the joint moves
        return (
            Parameter("mass", self.unit("kg", "kg m^2"), 0.0, most * self.total, 0.0),
            *self.swinging,
        )

    def shaken_in(self, log):
        seen = log.seen.get(self.joint)
        if seen is None:
            return None
        return Shaken(seen.time, seen.path, seen.stretches, seen.noise, seen.begun, seen.begun_sd)

    def shaking(self, world):
        return self.read(world, "qpos"), self.read(world, "qvel")

    def force(self, values, timestep, *, states=None, first=None, **_):
        push = characteristic_force(self.model, self.joint) / self.total
        begins = self.begins(values, states, push, timestep=timestep, first=first)
        return ForceShakenBefore(self, self.coefficients(values) | begins, timestep)
