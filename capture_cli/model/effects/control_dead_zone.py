"""A control that does nothing while it is small."""

import numpy as np

from capture_cli.model.effects._actuator_effect import UNIT, ActuatorEffect
from capture_cli.model.parameters import Parameter


def dead_zone(control, *, width):
    """0 within +-width, and nearer to 0 by width outside of it."""
    return np.sign(control) * np.maximum(np.abs(control) - width, 0.0)


class ControlDeadZone(ActuatorEffect):
    """Controls within +-`width` (in the control's own unit) do nothing; larger ones arrive smaller by
    `width`.
    """

    summary = "a control does nothing while it is small"
    kernel = staticmethod(dead_zone)

    @property
    def parameters(self):
        return (Parameter("width", UNIT, 0.0, self.scale, 0.0),)
