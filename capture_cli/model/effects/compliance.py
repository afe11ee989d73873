"""A transmission that gives: a belt, a long shaft, a harmonic drive."""

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.model.effects._scales import characteristic_force
from capture_cli.model.effects._transmission import TransmissionEffect
from capture_cli.model.effects._two_mass import TwoMass
from capture_cli.model.parameters import Parameter

SLOWEST = 2 * np.pi * 2.0  # rad/s: a drive softer than 2 Hz is not a model error but another machine


@frozen
class SETTINGS:
    # Generalized-alpha (Chung and Hulbert 1993): second order, and of vibrations that the step cannot follow this
    # part is kept from one step to the next.
    kept: float = 0.3


ALPHA_M, ALPHA_F = (2 * SETTINGS.kept - 1) / (SETTINGS.kept + 1), SETTINGS.kept / (SETTINGS.kept + 1)
GAMMA = 0.5 - ALPHA_M + ALPHA_F
BETA = 0.25 * (1 - ALPHA_M + ALPHA_F) ** 2


class Spring(TwoMass):
    """I d'' + (damping_time + I slowing) d' + (1 + compliance holding) d = compliance passed.

    I is the compliance times `against`.

    A step of generalized-alpha (Chung and Hulbert 1993), implicit in the spring.
    """

    def __init__(self, *, compliance, damping_time, rotor, timestep, **rest):
        super().__init__(rotor=rotor, timestep=timestep, **rest)
        self.compliance, self.damping_time = compliance, damping_time

    def at_rest(self, passed):
        return self.compliance * passed

    def advance(self, passed, against, slowing, holding):
        h, inverse, springs = self.timestep, self.compliance * against, 1 + self.compliance * holding
        damping = self.damping_time + inverse * slowing
        before, rate, acceleration = self.deflection, self.rate, self.acceleration
        # both as they would be at the end of the step if d'' were 0 there
        coming_rate = rate + h * (1 - GAMMA) * acceleration
        coming = before + h * rate + h * h * (0.5 - BETA) * acceleration
        resisting = damping * ((1 - ALPHA_F) * coming_rate + ALPHA_F * rate)
        resisting += springs * ((1 - ALPHA_F) * coming + ALPHA_F * before)
        stiffness = (1 - ALPHA_F) * (damping * GAMMA * h + springs * BETA * h * h)
        wound = self.compliance * passed - inverse * ALPHA_M * acceleration
        now = (wound - resisting) / (inverse * (1 - ALPHA_M) + stiffness)
        return coming + h * h * BETA * now, coming_rate + h * GAMMA * now, now


class Compliance(TransmissionEffect):
    """A spring between drive and joint that winds up by `compliance` (m/N or rad/(N m)) per unit of force.

    `rotor` (kg or kg m^2) is the part of the joint's inertia on the motor's side, `motor_damping` and `motor_friction`
    the shares of its damping and of its dry friction there. The spring's friction is `damping_time` (s) times its
    stiffness. The equations are in _two_mass.py; the step is implicit in the spring, so that any stiffness is stable.
    """

    summary = "a transmission that gives: the joint vibrates against its motor"
    shapes = ("rotor", "motor_damping", "damping_time", "motor_friction")
    kernel = Spring

    @property
    def parameters(self):
        softest = 1 / (SLOWEST**2 * self.total * 0.25)  # with a rotor of half of the inertia
        return (
            Parameter("compliance", self.unit("m/N", "rad/(N m)"), 0.0, softest, 0.0),
            self.rotor,
            self.motor_damping,
            Parameter("damping_time", "s", 1e-4, 2e-2, 2e-3),
            *self.motor_friction,
        )

    states_mean = (
        "`ahead`, `turning`: how far (m or rad) and how fast (m/s or rad/s; its `rate`) the rotor is ahead of where "
        "the forces of the moment wind it. At 1 `compliance` times the larger of the weight on the joint and what its "
        "actuators can give, and the speed at which the rotor swings through that"
    )

    def looseness(self, values):
        compliance, rotor, *_ = values.T
        wound = compliance * characteristic_force(self.model, self.joint)
        inverse = compliance * rotor * (1 - rotor / self.total)  # 1 / its own frequency, squared
        return wound, np.divide(wound, np.sqrt(inverse), out=np.zeros_like(wound), where=inverse > 0)
