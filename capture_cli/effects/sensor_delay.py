"""A sensor that reports late."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._sensor_effect import RememberingSensorEffect, at_times, earlier
from capture_cli.parameters import Parameter


def late(series, *, delay, timestep, ahead=0.0):
    """What was `delay` seconds ago. `delay` before the first row it is `ahead` of where even motion would have been,
    and in between by the square of the time, as where acceleration was constant.
    """
    steps = np.arange(series.shape[-2])[:, None] - delay / timestep
    before = np.maximum(-steps, 0.0) / np.maximum(delay / timestep, 1e-12)
    return at_times(series, steps) + ahead * before**2


class SensorDelay(RememberingSensorEffect):
    """The sensor reports what was `delay` (s) ago."""

    summary = "a sensor reports late"
    kernel = staticmethod(late)

    @property
    def parameters(self):
        return (Parameter("delay", "s", 0.0, 0.1, 0.0),)

    def undone(self, jets, values):
        return earlier(jets, values)
