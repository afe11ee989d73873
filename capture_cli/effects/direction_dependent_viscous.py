"""Viscous friction that differs with the direction of motion, as on a worn screw."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._joint_effect import JointEffect, raised
from capture_cli.parameters import Parameter
from capture_cli.sim.engine import World


class DirectionDependentViscous(JointEffect):
    """`asymmetry` is added to the joint's damping in forward motion, and subtracted from it in backward
    motion.

    In neither direction does the damping fall below zero: on a joint without damping only one direction has
    any. It changes MuJoCo's own damping step by step, which is integrated as that is.
    """

    place = "force"
    summary = "viscous friction that differs between forward and backward motion"

    @property
    def parameters(self):
        high = 2 * self.characteristic_force / self.characteristic_speed
        return (Parameter("asymmetry", self.unit("N s/m", "N m s/rad"), -high, high, 0.0),)

    def force(self, values, timestep):
        def by_direction(world: World) -> None:
            damping = world.vary("dof_damping")
            change = values[world.rows, 0] * np.sign(world.qvel[:, self.dof])
            damping[:, self.dof] = raised(damping[:, self.dof], change)

        return by_direction
