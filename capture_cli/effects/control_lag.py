"""A control that arrives through a first-order filter: the windings of a motor, a current controller."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._actuator_effect import ControlTimeEffect
from capture_cli.parameters import Parameter

FORGOTTEN = 20.0  # time constants, after which 2e-9 of a deviation is left


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


class ControlLag(ControlTimeEffect):
    """The control arrives through a first-order lag of `time_constant` (s). It is the mean over a step that
    arrives.
    """

    summary = "a control arrives through a first-order lag"
    kernel = Lag

    @property
    def parameters(self):
        return (Parameter("time_constant", "s", 0.0, 0.2, 0.0),)

    def memory(self, values):
        return FORGOTTEN * float(values.max())
