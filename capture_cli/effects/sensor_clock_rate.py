"""A logger whose clock does not keep time."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._sensor_effect import TimeEffect, at_times
from capture_cli.effects.base import GLOBAL
from capture_cli.parameters import Parameter


def off_clock(series, *, error):
    """The series at (1 + error) times its time, counted from the first row."""
    return at_times(series, np.arange(series.shape[-2])[:, None] * (1 + error))


class SensorClockRate(TimeEffect):
    """In one second of the log (1 + `error`) s went by, for all sensors, counted from the start of the
    simulation.

    The controls keep the model's time.
    """

    summary = "the sensors' clock runs slow or fast"
    where = "the sensors together"
    kernel = staticmethod(off_clock)

    @classmethod
    def sites(cls, model):
        return [GLOBAL] if model.nsensordata else []

    @property
    def parameters(self):
        return (Parameter("error", "1", -0.05, 0.05, 0.0),)

    def undone(self, jets, values):
        rate = 1 + values
        return np.stack([jets[:, 0], jets[:, 1] / rate, jets[:, 2] / rate**2], axis=1)
