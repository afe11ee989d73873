"""A control that arrives late."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._actuator_effect import ActuatorEffect
from capture_cli.parameters import Parameter


class ControlDelay(ActuatorEffect):
    """The control arrives `delay` (s) late. Of a part of a step it is the mean over the step that arrives."""

    summary = "a control arrives late"

    @property
    def parameters(self):
        return (Parameter("delay", "s", 0.0, 0.1, 0.0),)

    def changed(self, control, values, timestep):
        late = values / timestep
        whole = np.floor(late)
        part = late - whole
        at = np.arange(control.shape[1]) - whole.astype(int)
        row = np.arange(len(control))[:, None]
        now, before = control[row, np.maximum(at, 0)], control[row, np.maximum(at - 1, 0)]
        return now + part * (before - now)
