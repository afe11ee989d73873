"""Play between a motor and what it drives."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._scales import characteristic_force
from capture_cli.effects._two_mass import TransmissionEffect, TwoMass
from capture_cli.parameters import Parameter


class Play(TwoMass):
    """Within +-width / 2 the rotor turns alone; at an end it stays with the link until the force turns round."""

    def __init__(self, *, width, timestep, **rest):
        super().__init__(timestep=timestep, **rest)
        self.half = width / 2

    def at_rest(self, passed):
        return self.half * np.sign(passed)

    def limited(self, deflection):
        return np.clip(deflection, -self.half, self.half)

    def advance(self, passed, against, slowing):
        h, before = self.timestep, self.deflection
        after = self.limited(before + h * (self.rate + h * passed / against) / (1 + h * slowing))
        return after, (after - before) / h, 0.0


class Backlash(TransmissionEffect):
    """Play of `width` (m or rad) between drive and joint, in which the motor turns alone and drives nothing.

    `rotor` (kg or kg m^2) is the part of the joint's inertia on the motor's side, `motor_damping` and `motor_friction`
    the shares of its damping and of its dry friction there. At an end of the play the two collide without rebound and
    stay together until the force turns round; the equations are in _two_mass.py. A simulation begins with the play
    taken up in the direction of the force.
    """

    summary = "play between a motor and what it drives"
    shapes = ("rotor", "motor_damping", "motor_friction")
    kernel = Play

    @property
    def parameters(self):
        width = Parameter("width", self.unit("m", "rad"), 0.0, 0.1 * self.travel, 0.0)
        return (width, self.rotor, self.motor_damping, *self.motor_friction)

    def looseness(self, values):
        width, rotor, *_ = values.T
        return width, np.sqrt(2 * width * characteristic_force(self.model, self.joint) / rotor)
