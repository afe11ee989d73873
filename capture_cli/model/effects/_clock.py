"""Clocks that do not keep time, as a kernel; and how what they show moved in truth."""

import numpy as np

from capture_cli.log.windows import at_times


def off_clock(series, *, error, elapsed_steps=0.0):
    """The series at (1 + error) times its time, which is `elapsed_steps` steps at the first row."""
    steps = np.arange(series.shape[-2])[:, None]
    return at_times(series, steps * (1 + error) + error * elapsed_steps)


def on_time(derivatives, *, error):
    """Derivatives (simulation, 3, column) of what such a clock, of `error` (simulation, 1), reports, by a right one."""
    rate = 1 + error
    return np.stack([derivatives[:, 0], derivatives[:, 1] / rate, derivatives[:, 2] / rate**2], axis=1)
