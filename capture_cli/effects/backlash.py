"""Play between a motor and what it drives."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._joint_effect import JointEffect, driven_joints
from capture_cli.effects._scales import free_inertia
from capture_cli.effects._two_mass import TwoMass
from capture_cli.parameters import Parameter


class Backlash(JointEffect):
    """Play of `width` (m or rad) between drive and joint, in which the motor turns alone and drives nothing.

    `rotor` (kg or kg m^2) is the part of the joint's inertia on the motor's side. At an end of the play the
    two collide without rebound and stay together until the force turns round; the equations are in
    _two_mass.py. A simulation begins with the play taken up in the direction of the force.
    """

    place = "force"
    summary = "play between a motor and what it drives"
    where = "every hinge and slide joint that an actuator drives"
    shapes = ("rotor",)

    @classmethod
    def sites(cls, model):
        return driven_joints(model)

    @property
    def parameters(self):
        mass = free_inertia(self.model, self.joint)
        return (
            Parameter("width", self.unit("m", "rad"), 0.0, 0.1 * self.travel, 0.0),
            Parameter("rotor", self.unit("kg", "kg m^2"), 0.05 * mass, 0.5 * mass, 0.2 * mass),
        )

    def force(self, values, timestep):
        width, rotor = values.T
        return _Play(self.dof, free_inertia(self.model, self.joint), rotor, timestep, width)


class _Play(TwoMass):
    def __init__(self, dof, total, rotor, timestep, width):
        super().__init__(dof, total, rotor, timestep)
        self.half = width / 2

    def at_rest(self, rows, passed):
        return self.half[rows] * np.sign(passed)

    def advance(self, rows, pull):
        h, half, before = self.timestep, self.half[rows], self.deflection[rows]
        after = np.clip(before + h * (self.rate[rows] + h * pull), -half, half)
        return after, (after - before) / h
