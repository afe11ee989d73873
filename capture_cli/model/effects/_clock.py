"""Clocks that do not keep time, as a kernel; and how what they show moved in truth."""

from __future__ import annotations

import numpy as np

from capture_cli.log.windows import at_times


def off_clock(series, *, error, begun=0.0):
    """The series at (1 + error) times its time, which is `begun` steps at the first row."""
    steps = np.arange(series.shape[-2])[:, None]
    return at_times(series, steps * (1 + error) + error * begun)


def on_time(jets, *, error):
    """Jets (simulation, 3, column) of what is reported by such a clock, of `error` (simulation, 1), by a right one."""
    rate = 1 + error
    return np.stack([jets[:, 0], jets[:, 1] / rate, jets[:, 2] / rate**2], axis=1)
