"""What changes after a machine is started, until it no longer does: a motor that warms, a battery that sags."""

import numpy as np

from capture_cli.model.parameters import Parameter

TIME_CONSTANT = Parameter("time_constant", "s", 0.5, 100.0, 10.0)


def grown(time, *, change, time_constant):
    """How many times as large at `time`, s, since it began: 1 + change (1 - e^(-time / time_constant))."""
    return 1 - change * np.expm1(-np.maximum(time, 0.0) / time_constant)
