"""A sensor that reports no more than its range: a gyroscope, an accelerometer, a load cell, a converter."""

import mujoco
import numpy as np

from capture_cli.log.range_ends import largest_of, piled_up_from
from capture_cli.model.effects._limited import saturated, unlimited_at
from capture_cli.model.effects._places import site_id
from capture_cli.model.effects._sensor_effect import NumberEffect, quantity
from capture_cli.model.parameters import Parameter

UNITS = ("m/s", "rad/s", "m/s^2", "N", "N m", "T")  # what sensors measure that have a range


class SensorSaturation(NumberEffect):
    """Numbers beyond +-`limit`, in the sensor's unit, are reported as `limit`; at its null, the end of its range,
    nothing is cut off. Beyond that it cuts off as it does below.

    In a log, numbers pile up at a limit, and it is looked for where they do. What is cut off is gone: speeds at the
    start of windows that begin there are left open, and positions are not among its sites, for where a window begins
    would be unknown.
    """

    summary = "a sensor reports no more than its range: a gyroscope, an accelerometer, a load cell"
    where = "every sensor of speeds, accelerations, forces, torques, fields or ranges"
    has_threshold = True
    kernel = staticmethod(saturated)
    _largest: float | None = None  # of what the log has
    _piled_up = True

    @classmethod
    def sites(cls, model):
        return [site for site in super().sites(model) if _has_a_range(model, site_id(model, "sensor", site))]

    def look_in(self, log):
        super().look_in(log)
        if log.reports is not None:
            reported = log.reports.values[:, self.columns]
            self._largest, self._piled_up = largest_of(reported), piled_up_from(reported) < np.inf

    @property
    def shows(self):
        return super().shows and self._piled_up

    @property
    def parameters(self):
        beyond = 1.05  # of the largest number of a log: where nothing is cut off
        high = beyond * self._largest if self._largest else 2 * self.quantity.size
        least = 0.5  # of it, of a limit: noise is what is reported beyond that
        low = least * self._largest if self._largest else 0.02 * self.quantity.size
        return (Parameter("limit", self.quantity.unit, low, high, high),)

    def coefficients(self, values):
        return {"limit": unlimited_at(self.parameters[0].nominal, values[:, [0]])}


def _has_a_range(model: mujoco.MjModel, sensor: int) -> bool:
    """Whether what is measured can leave the range of the sensor, and is no position that initial states are read
    off.
    """
    ranges = int(model.sensor_type[sensor]) == int(mujoco.mjtSensor.mjSENS_RANGEFINDER)
    return ranges or quantity(model, sensor).unit in UNITS
