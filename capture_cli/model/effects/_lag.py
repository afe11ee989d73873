"""A first-order lag, as a kernel."""

from __future__ import annotations

import numpy as np


class Lag:
    """A first-order lag, x' = (control - x) / time_constant; the mean of x over the step."""

    def __init__(self, *, time_constant, timestep):
        steps = time_constant / timestep
        self.kept = np.exp(-1 / np.maximum(steps, 1e-12))  # of a deviation, from one step to the next
        self.mean = steps * (1 - self.kept)  # of a deviation, over the step
        self.state = None

    def __call__(self, control):
        before = control if self.state is None else self.state
        self.state = control + self.kept * (before - control)
        return control + self.mean * (before - control)
