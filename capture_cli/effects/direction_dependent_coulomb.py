"""Dry friction that differs with the direction of motion."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._joint_effect import JointEffect, raised
from capture_cli.parameters import Parameter
from capture_cli.sim.engine import World


class DirectionDependentCoulomb(JointEffect):
    """`asymmetry` is added to the joint's dry friction in forward motion, and subtracted from it in backward
    motion.

    In neither direction does the friction fall below zero: on a joint without friction only one direction has
    any.
    """

    place = "force"
    summary = "dry friction that differs between forward and backward motion"

    @property
    def parameters(self):
        high = self.characteristic_force
        return (Parameter("asymmetry", self.unit("N", "N m"), -high, high, 0.0),)

    def force(self, values, timestep):
        def by_direction(world: World) -> None:
            friction = world.vary("dof_frictionloss")
            change = values[world.rows, 0] * np.sign(world.qvel[:, self.dof])
            friction[:, self.dof] = raised(friction[:, self.dof], change)

        return by_direction
