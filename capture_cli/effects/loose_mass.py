"""Something inside that is not fixed: a liquid that sloshes, a load that swings, a part on soft mounts."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._joint_force import ForceOfKernel, JointForce
from capture_cli.effects._scales import characteristic_force, free_inertia
from capture_cli.effects._two_mass import MOST_SHARE
from capture_cli.effects.base import spread
from capture_cli.parameters import Parameter

MOST = 0.8  # of what the joint moves
SLOWEST, FASTEST = 0.3, 20.0  # Hz
# Swings within a window, at least: with how it begins free, less of one imitates any force that changes slowly.
SWINGS = 0.5


class Oscillator:
    """The force -m d'' on a joint, of whose inertia M the part m hangs on a spring and is d ahead of the rest.

    The model carries all of M rigidly. With a the joint's acceleration the loose part obeys
    m (a + d'') = -k d - c d', and all together M a = F - m d'', with F what the model knows of. Eliminating a,

        d'' (1 - m / M) + 2 zeta w d' + w^2 d = -b,   w^2 = k / m,   2 zeta w = c / m,

    b = a + (m / M) d'' being the acceleration without the extra force. A trapezoidal step in d, which damps no
    vibration of its own; b is that of the step before.
    """

    def __init__(self, *, mass, frequency, damping_ratio, timestep, ahead=0.0, moving=0.0):
        self.mass, self.timestep = mass, timestep
        self.turning = 2 * np.pi * frequency  # w, rad/s
        self.slowing = 2 * damping_ratio * self.turning
        self.displaced, self.rate = ahead + 0.0 * mass, moving + 0.0 * mass  # d, d'
        self.change = 0.0 * mass  # d''
        self.extra, self.speed = 0.0 * mass, None  # the force of the last step, and the joint's speed there

    def __call__(self, qvel, qacc, inertia):
        """The force. qacc and inertia (M) are of the step before."""
        h, mass = self.timestep, np.minimum(self.mass, MOST_SHARE * inertia)
        apart = 1 - mass / inertia
        if self.speed is None:
            rigid = qacc
            held = self.turning**2 * self.displaced + self.slowing * self.rate
            self.change = -(rigid + held) / apart
        else:
            rigid = (qvel - self.speed) / h - self.extra / inertia
        pulled = self.turning**2 * (self.displaced + h * self.rate + h * h / 4 * self.change)
        pulled = pulled + self.slowing * (self.rate + h / 2 * self.change)
        resists = apart + self.slowing * h / 2 + (self.turning * h) ** 2 / 4
        now = -(rigid + pulled) / resists
        mean = (self.change + now) / 2
        self.displaced = self.displaced + h * self.rate + h * h / 2 * mean
        self.rate, self.change = self.rate + h * mean, now
        self.extra, self.speed = -mass * mean, np.array(qvel)
        return self.extra


class LooseMass(JointForce):
    """Of what the joint moves, `mass` (kg or kg m^2) hangs on a spring along it: it swings at `frequency` (Hz) where
    the joint is held, and `damping_ratio` is of the critical damping.

    The declared inertia holds it: with nothing loose, all of it is rigid.
    """

    summary = "something inside that is not fixed: a liquid that sloshes, a load that swings"
    shapes = ("frequency", "damping_ratio")
    vague_at_end = ("frequency",)
    states = ("displaced", "moving")
    kernel = Oscillator

    @property
    def total(self) -> float:
        """kg or kg m^2: what a force on the joint accelerates."""
        return free_inertia(self.model, self.joint)

    @property
    def parameters(self):
        slowest = float(np.clip(SWINGS / (self.window or np.inf), SLOWEST, FASTEST / 4))
        return (
            Parameter("mass", self.unit("kg", "kg m^2"), 0.0, MOST * self.total, 0.0),
            Parameter("frequency", "Hz", slowest, FASTEST, max(2 * slowest, 2.0)),
            Parameter("damping_ratio", "1", 0.002, 0.7, 0.05),
        )

    def shape_grid(self, count=5):
        # resonances are narrow, and how narrow shows once the frequency is right
        grid = np.repeat(self.space.nominal[None], 2 * count, axis=0)
        grid[:, 1] = spread(self.parameters[1], 2 * count)
        return grid

    def doubt(self, values, duration):
        if values[1] * duration >= 1:
            return None
        return f"it swings once in {1 / values[1]:.3g} s, and no episode lasts longer than {duration:.3g} s"

    def force(self, values, timestep, *, states=None, **_):
        states = np.zeros((len(values), len(self.states))) if states is None else states
        turning = 2 * np.pi * values[:, 1]
        push = characteristic_force(self.model, self.joint) / self.total
        start = {"ahead": push / turning**2 * states[:, 0], "moving": push / turning * states[:, 1]}
        return ForceOfKernel(self, self.coefficients(values) | start, timestep)
