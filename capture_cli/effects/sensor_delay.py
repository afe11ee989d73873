"""A sensor that reports late."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._sensor_effect import TimeEffect, at_times, earlier
from capture_cli.parameters import Parameter


def late(series, *, delay, timestep):
    """What was `delay` seconds ago; before the first row, motion is taken to have been even."""
    return at_times(series, np.arange(series.shape[-2])[:, None] - delay / timestep)


class SensorDelay(TimeEffect):
    """The sensor reports what was `delay` (s) ago; before the start, motion is taken to have been even."""

    summary = "a sensor reports late"
    kernel = staticmethod(late)

    @property
    def parameters(self):
        return (Parameter("delay", "s", 0.0, 0.1, 0.0),)

    def undone(self, jets, values):
        return earlier(jets, values)
