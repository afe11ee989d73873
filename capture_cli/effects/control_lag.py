"""A control that arrives through a first-order filter: the windings of a motor, a current controller."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._actuator_effect import ActuatorEffect
from capture_cli.parameters import Parameter


class ControlLag(ActuatorEffect):
    """The control arrives through a first-order lag of `time_constant` (s). It is the mean over a step that
    arrives.
    """

    summary = "a control arrives through a first-order lag"

    @property
    def parameters(self):
        return (Parameter("time_constant", "s", 0.0, 0.2, 0.0),)

    def changed(self, control, values, timestep):
        steps = values[:, 0] / timestep
        kept = np.exp(-1 / np.maximum(steps, 1e-12))  # of a deviation, from one step to the next
        mean = steps * (1 - kept)  # of a deviation, over the step
        arrived = np.empty_like(control)
        state = control[:, 0].copy()
        for k, now in enumerate(control.T):
            arrived[:, k] = now + mean * (state - now)
            state = now + kept * (state - now)
        return arrived
