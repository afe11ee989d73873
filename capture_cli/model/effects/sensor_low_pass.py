"""A sensor behind a low-pass filter."""

import numpy as np

from capture_cli.model.effects._sensor_filter import SensorFilter
from capture_cli.model.parameters import Parameter


def low_passed(series, *, time_constant, timestep, ahead=0.0):
    """A first-order lag, exact for a series that is straight between rows.

    It begins with what is reported `ahead` of what it would be had motion before the first row been even.
    """
    steps = time_constant / timestep
    kept = np.exp(-1 / np.maximum(steps, 1e-12))
    slope = np.diff(series, axis=-2, append=series[..., -1:, :])
    out = np.empty_like(series)
    behind = ahead - slope[..., :1, :] * steps  # what is reported less what is there
    for k in range(series.shape[-2]):
        out[..., k : k + 1, :] = series[..., k : k + 1, :] + behind
        ramp = slope[..., k : k + 1, :] * steps
        behind = kept * (behind + ramp) - ramp
    return out


class SensorLowPass(SensorFilter):
    """What is reported follows through a first-order lag of `time_constant` (s).

    Exact for a signal that is straight between grid points. What was reported before a simulation began is a state of
    its own for each number; at 0 it is as if motion had been even.
    """

    summary = "a sensor reports through a first-order low-pass filter"
    kernel = staticmethod(low_passed)
    parameters = (Parameter("time_constant", "s", 0.0, 0.5, 0.0),)
    begins_with = ("ahead",)

    def undone(self, derivatives, values):
        value, slope, curvature = derivatives[:, 0], derivatives[:, 1], derivatives[:, 2]
        # x = y + T y', and the third derivative is not known
        return np.stack([value + values * slope, slope + values * curvature, curvature], axis=1)
