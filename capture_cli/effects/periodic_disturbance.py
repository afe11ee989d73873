"""A force that repeats with time: an unbalanced fan, a machine next door, the mains."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._joint_effect import JointEffect
from capture_cli.parameters import Parameter
from capture_cli.sim.engine import World


class PeriodicDisturbance(JointEffect):
    """The joint force `sine` sin(2 pi f t) + `cosine` cos(2 pi f t) with f the `frequency` and t the log's
    time.
    """

    place = "force"
    summary = "a force that repeats with time: vibration from outside"
    shapes = ("frequency",)

    @property
    def parameters(self):
        high, unit = self.characteristic_force, self.unit("N", "N m")
        fastest = min(20.0, 0.1 / float(self.model.opt.timestep))
        return (
            Parameter("sine", unit, -high, high, 0.0),
            Parameter("cosine", unit, -high, high, 0.0),
            Parameter("frequency", "Hz", 0.1, fastest, 1.0),
        )

    def force(self, values, timestep):
        sine, cosine, frequency = values.T

        def with_time(world: World) -> None:
            rows = world.rows
            phase = 2 * np.pi * frequency[rows] * world.time
            world.qfrc_applied[:, self.dof] += sine[rows] * np.sin(phase) + cosine[rows] * np.cos(phase)

        return with_time
