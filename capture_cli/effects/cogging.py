"""A force that repeats with position: a motor's cogging, a gear's teeth."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._joint_effect import JointEffect
from capture_cli.parameters import Parameter
from capture_cli.sim.engine import World


class Cogging(JointEffect):
    """The joint force `sine` sin(2 pi x / `period`) + `cosine` cos(2 pi x / `period`); it stores and gives
    back energy.
    """

    place = "force"
    summary = "a force that repeats with position: magnets or teeth"
    shapes = ("period",)

    @property
    def parameters(self):
        high, unit = self.characteristic_force, self.unit("N", "N m")
        full = 2 * np.pi if self.is_hinge else 2 * self.travel
        return (
            Parameter("sine", unit, -high, high, 0.0),
            Parameter("cosine", unit, -high, high, 0.0),
            Parameter("period", self.unit("m", "rad"), full / 50, full, full / 6),
        )

    def force(self, values, timestep):
        sine, cosine, period = values.T
        position = int(self.model.jnt_qposadr[self.joint])

        def with_position(world: World) -> None:
            rows = world.rows
            phase = 2 * np.pi * world.qpos[:, position] / period[rows]
            world.qfrc_applied[:, self.dof] += sine[rows] * np.sin(phase) + cosine[rows] * np.cos(phase)

        return with_position
