"""A sensor with an offset."""

from __future__ import annotations

import mujoco

from capture_cli.effects._sensor_effect import NumberEffect
from capture_cli.effects.base import GLOBAL
from capture_cli.parameters import Parameter


def offset_readings(series, *, offset):
    """series + offset, which is one number or one for each column."""
    return series + offset


class SensorBias(NumberEffect):
    """An offset, in the sensor's unit, of each of its numbers: `offset`, or `x`, `y` and `z`."""

    summary = "a sensor reports with an offset"
    kernel = staticmethod(offset_readings)

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        size = self.columns.stop - self.columns.start
        self.names = ("offset",) if size == 1 else tuple("xyz"[:size])

    @property
    def parameters(self):
        high = 0.3 * self.quantity.size
        return tuple(Parameter(name, self.quantity.unit, -high, high, 0.0) for name in self.names)

    def coefficients(self, values):
        return {"offset": values}

    def undone(self, jets, values):
        true = jets.copy()
        true[:, 0] -= values
        return true
