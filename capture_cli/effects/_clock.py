"""Clocks that do not keep time, as a kernel."""

from __future__ import annotations

import numpy as np

from capture_cli.sim.windows import at_times


def off_clock(series, *, error, begun=0.0):
    """The series at (1 + error) times its time, which is `begun` steps at the first row."""
    steps = np.arange(series.shape[-2])[:, None]
    return at_times(series, steps * (1 + error) + error * begun)
