"""A force that repeats with time: an unbalanced fan, a machine next door, the mains."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._periodic_force import SHAPE_STEP, PeriodicForce
from capture_cli.parameters import Parameter

FEWEST_PERIODS = 2.0


def periodic_disturbance(time, *, sine, cosine, frequency):
    """Joint force: sine sin(2 pi f t) + cosine cos(2 pi f t), f the frequency in Hz, t in s since the log began."""
    phase = 2 * np.pi * frequency * time
    return sine * np.sin(phase) + cosine * np.cos(phase)


class PeriodicDisturbance(PeriodicForce):
    """The joint force `sine` sin(2 pi f t) + `cosine` cos(2 pi f t) with f the `frequency` and t in s
    since the log began: since its first time, whatever that is.
    """

    summary = "a force that repeats with time: vibration from outside"
    shapes = ("frequency",)
    kernel = staticmethod(periodic_disturbance)

    def doubt(self, values, duration):
        periods = values[2] * duration
        if periods < FEWEST_PERIODS:
            return f"only {periods:.2g} of its periods fit into an episode: any slow change looks like that"
        return None

    @property
    def parameters(self):
        high, unit = self.characteristic_force, self.unit("N", "N m")
        return (
            Parameter("sine", unit, -high, high, 0.0),
            Parameter("cosine", unit, -high, high, 0.0),
            Parameter("frequency", "Hz", 0.1, 1 / self.shortest_period, 1.0, SHAPE_STEP),
        )
