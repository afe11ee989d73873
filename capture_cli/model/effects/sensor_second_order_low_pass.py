"""A sensor behind a low-pass filter of second order: Butterworth, Bessel, an RC filter twice."""

import numpy as np

from capture_cli.model.effects._lag import second_order_step
from capture_cli.model.effects._sensor_filter import SensorFilter
from capture_cli.model.parameters import Parameter


def second_order_low_passed(series, *, time_constant, damping_ratio, timestep, ahead=0.0, rising=0.0):
    """T^2 y'' + 2 damping_ratio T y' + y = series, with T the time_constant; exact for a series that is straight
    between rows.

    It begins with y `ahead` and T y' `rising` of what they would be had motion before the first row been even.
    """
    kept, rate_kept = second_order_step(time_constant, damping_ratio, timestep)
    slope = np.diff(series, axis=-2, append=series[..., -1:, :]) * (time_constant / timestep)
    lag = 2 * damping_ratio
    out = np.empty_like(series)
    behind = ahead - lag * slope[..., :1, :]  # y less the series
    rate = rising + slope[..., :1, :]  # T y'
    for k in range(series.shape[-2]):
        out[..., k : k + 1, :] = series[..., k : k + 1, :] + behind
        ramp = slope[..., k : k + 1, :]
        # the deviation from how the ramp would be followed for ever, and T times its slope
        e, e_rate = behind + lag * ramp, rate - ramp
        behind = kept[0] * e + kept[1] * e_rate - lag * ramp
        rate = rate_kept[0] * e + rate_kept[1] * e_rate + ramp
    return out


class SensorSecondOrderLowPass(SensorFilter):
    """What is reported follows through a second-order lag of natural frequency 1 / `time_constant` (rad/s) and of
    `damping_ratio` (Butterworth: 0.71, Bessel: 0.87).

    Exact for a signal that is straight between grid points. What was reported before a simulation began are two states
    for each number; at 0 it is as if motion had been even.
    """

    summary = "a sensor reports through a second-order low-pass filter: Butterworth, Bessel"
    shapes = ("damping_ratio",)
    kernel = staticmethod(second_order_low_passed)
    parameters = (
        Parameter("time_constant", "s", 0.0, 0.3, 0.0),
        Parameter("damping_ratio", "1", 0.3, 1.5, 0.7),
    )
    begins_with = ("ahead", "rising")

    def undone(self, derivatives, values):
        value, slope, curvature = derivatives[:, 0], derivatives[:, 1], derivatives[:, 2]
        time, lag = values[:, :1], 2 * values[:, 1:] * values[:, :1]
        # x = y + 2 damping_ratio T y' + T^2 y'', and no derivative beyond the second is known
        return np.stack(
            [value + lag * slope + time * time * curvature, slope + lag * curvature, curvature], axis=1
        )
