"""A sensor that holds no steady value: a piezo cell with its charge amplifier, an IEPE accelerometer, AC coupling."""

import numpy as np

from capture_cli.model.effects._followed_log import measured_stretches
from capture_cli.model.effects._sensor_effect import SensorEffect, quantity
from capture_cli.model.effects.base import Reports
from capture_cli.model.object_names import object_name
from capture_cli.model.parameters import Parameter

UNITS = ("N", "N m", "m/s^2")  # what sensors that are coupled so commonly measure


def high_passed(series, *, rate, timestep, held=0.0):
    """series - m, where m' is `rate` times what is reported, exact where that is straight between rows; m begins at
    `held`.
    """
    share = rate * timestep / 2
    out = np.empty_like(series)
    out[..., :1, :] = series[..., :1, :] - held
    for k in range(1, series.shape[-2]):
        held = held + share * out[..., k - 1 : k, :]
        out[..., k : k + 1, :] = (series[..., k : k + 1, :] - held) / (1 + share)
        held = held + share * out[..., k : k + 1, :]
    return out


class SensorHighPass(SensorEffect):
    """What is reported, y = x - m, is what is there less a mean that follows it at `rate` (1/s): m' = rate (x - m).

    A steady value has fallen to 37 % after 1 / `rate` seconds. Exact for reports that are straight between grid
    points. What m is when a window begins follows from what was reported since the episode began, or went on after a
    gap, and from what m was then, which nobody knows: a state of its own for each number. A simulation that begins
    otherwise begins with m = 0, a sensor that was just switched on.
    """

    summary = "a sensor does not hold a steady value: a charge amplifier, an IEPE accelerometer, AC coupling"
    where = "every sensor of forces, torques or accelerations"
    kernel = staticmethod(high_passed)
    parameters = (Parameter("rate", "1/s", 0.0, 2 * np.pi * 2.0, 0.0),)  # the filter's corner: 2 Hz at most
    _reported: np.ndarray | None = None  # (step, number): over time, since the stretch of the log began

    @classmethod
    def sites(cls, model):
        found = ((s, quantity(model, s)) for s in range(model.nsensor))
        return [object_name(model, "sensor", s) for s, q in found if q and q.unit in UNITS]

    states_mean = (
        "`held K`: the mean m of its number K when the episode began, in the sensor's unit. At 1 a common size of that "
        "number times 1 - exp(-`rate` T), with T the length of the longest episode, s"
    )

    @property
    def states(self):
        return tuple(f"held {k}" for k in range(len(self.sizes)))

    def look_in(self, log):
        super().look_in(log)
        self._reported = None if log.reports is None else integrated(log.reports, self.columns)

    def measure(self, sensors, values, timestep, *, states=None, first=None, **_):
        states = np.zeros(len(self.states)) if states is None else states
        # as of a value of the common size since the sensor was switched on, as long before as an episode lasts
        on_before = 1.0  # s, for which a sensor was on before a simulation that begins in no log
        held = self.sizes * states * -np.expm1(-values * (self.longest or on_before))
        if first is not None and self._reported is not None:
            held = held + values * self._reported[first]
        return self.measured(sensors, values, timestep, held=held)

    def undone(self, derivatives, values):
        value, slope, curvature = derivatives[:, 0], derivatives[:, 1], derivatives[:, 2]
        # x' = y' + rate y, where a window begins with m = 0; no start is read off such a sensor
        return np.stack([value, slope + values * value, curvature + values * slope], axis=1)


def integrated(reports: Reports, columns: slice) -> np.ndarray:
    """Integrals (step, column) of what was reported over time since each stretch began, straight where it was not."""
    from scipy.integrate import cumulative_trapezoid

    reported = reports.values[:, columns]
    integrals = np.zeros(reported.shape)
    for column, values in enumerate(reported.T):
        for steps, time, report in measured_stretches(reports.time, values, reports.stretches):
            integrals[steps, column] = cumulative_trapezoid(report(time), time, initial=0.0)
    return integrals
