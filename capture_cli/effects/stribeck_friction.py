"""Dry friction that is larger at rest than in motion."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._joint_effect import JointEffect
from capture_cli.parameters import Parameter
from capture_cli.sim.engine import World


class StribeckFriction(JointEffect):
    """`breakaway` exp(-(v / `speed`)^2) is added to the joint's dry friction."""

    place = "force"
    summary = "dry friction that is larger at rest than in motion: stick-slip"
    shapes = ("speed",)

    @property
    def parameters(self):
        fast = self.characteristic_speed
        return (
            Parameter("breakaway", self.unit("N", "N m"), 0.0, self.characteristic_force, 0.0),
            Parameter("speed", self.unit("m/s", "rad/s"), 2e-3 * fast, 0.5 * fast, 0.03 * fast),
        )

    def force(self, values, timestep):
        breakaway, speed = values.T

        def near_rest(world: World) -> None:
            rate = world.qvel[:, self.dof] / speed[world.rows]
            world.vary("dof_frictionloss")[:, self.dof] += breakaway[world.rows] * np.exp(-np.square(rate))

        return near_rest
