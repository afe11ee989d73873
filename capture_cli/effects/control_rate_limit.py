"""A control that cannot jump."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._actuator_effect import UNIT, ActuatorEffect
from capture_cli.parameters import Parameter

SLOWEST = 2.0  # s, from nothing to a full control


class ControlRateLimit(ActuatorEffect):
    """The control needs at least `slowness` (s per unit of the control) to change by one unit; at 0 it can
    jump.

    It is the mean over a step that arrives.
    """

    summary = "a control cannot change faster than at some rate"

    @property
    def parameters(self):
        return (Parameter("slowness", f"s/{UNIT}", 0.0, SLOWEST / self.scale, 0.0),)

    def changed(self, control, values, timestep):
        slowness = values[:, 0] / timestep  # steps per unit
        arrived = np.empty_like(control)
        state = control[:, 0].copy()
        for k, now in enumerate(control.T):
            gap = now - state
            steps = np.abs(gap) * slowness
            moved = gap / np.maximum(steps, 1)
            arrived[:, k] = np.where(steps <= 1, now - gap * steps / 2, state + moved / 2)
            state = np.where(steps <= 1, now, state + moved)
        return arrived
