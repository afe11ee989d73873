"""Dry friction that depends on where a joint is: a rough patch, a bent rail."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._joint_effect import JointEffect
from capture_cli.parameters import Parameter
from capture_cli.sim.engine import World


class PositionDependentFriction(JointEffect):
    """`friction` exp(-((x - `centre`) / `width`)^2 / 2) is added to the joint's dry friction."""

    place = "force"
    summary = "a rough patch: more dry friction around one position of a joint"
    shapes = ("centre", "width")

    @property
    def parameters(self):
        middle = float(self.model.jnt_range[self.joint].mean()) if self.model.jnt_limited[self.joint] else 0.0
        length = self.unit("m", "rad")
        return (
            Parameter("friction", self.unit("N", "N m"), 0.0, self.characteristic_force, 0.0),
            Parameter("centre", length, middle - self.travel, middle + self.travel, middle),
            Parameter("width", length, 0.02 * self.travel, self.travel, 0.15 * self.travel),
        )

    def force(self, values, timestep):
        friction, centre, width = values.T
        position = int(self.model.jnt_qposadr[self.joint])

        def on_patch(world: World) -> None:
            away = (world.qpos[:, position] - centre[world.rows]) / width[world.rows]
            world.vary("dof_frictionloss")[:, self.dof] += friction[world.rows] * np.exp(
                -0.5 * np.square(away)
            )

        return on_patch
