"""A sensor with few digits."""

import numpy as np

from capture_cli.model.effects._sensor_effect import NumberEffect
from capture_cli.model.parameters import Parameter


def quantised(series, *, step):
    """The nearest multiple of step; the series itself where that is 0."""
    coarse = step * np.round(series / np.where(step > 0, step, 1.0))
    return np.where(step > 0, coarse, series)


class SensorQuantisation(NumberEffect):
    """The sensor reports the nearest multiple of `step`, in its unit. Rounding has no slope, neither at null
    nor beyond.
    """

    summary = "a sensor reports in coarse steps, as an encoder does"
    kernel = staticmethod(quantised)

    @property
    def parameters(self):
        return (Parameter("step", self.quantity.unit, 0.0, 0.1 * self.quantity.size, 0.0),)
