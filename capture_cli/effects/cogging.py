"""A force that repeats with position: a motor's cogging, a gear's teeth."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._periodic_force import SHAPE_STEP, PeriodicForce
from capture_cli.parameters import Parameter

FINEST = 150  # to a turn: teeth of a worm wheel; finer ones cost every log as many more shapes that may fit by chance


def cogging(qpos, *, sine, cosine, period):
    """Joint force: sine sin(2 pi x / period) + cosine cos(2 pi x / period)."""
    phase = 2 * np.pi * qpos / period
    return sine * np.sin(phase) + cosine * np.cos(phase)


class Cogging(PeriodicForce):
    """The joint force `sine` sin(2 pi x / `period`) + `cosine` cos(2 pi x / `period`); it stores and gives
    back energy.
    """

    summary = "a force that repeats with position: magnets or teeth"
    shapes = ("period",)
    kernel = staticmethod(cogging)

    @staticmethod
    def frequency(shape):
        return 1 / shape

    @property
    def parameters(self):
        high, unit = self.characteristic_force, self.unit("N", "N m")
        full = 2 * np.pi if self.is_hinge else 2 * self.travel
        return (
            Parameter("sine", unit, -high, high, 0.0),
            Parameter("cosine", unit, -high, high, 0.0),
            Parameter("period", self.unit("m", "rad"), full / FINEST, full, full / 6, SHAPE_STEP),
        )
