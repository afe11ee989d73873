"""A control with an offset."""

from __future__ import annotations

from capture_cli.effects._actuator_effect import UNIT, ActuatorEffect
from capture_cli.parameters import Parameter


class ControlBias(ActuatorEffect):
    """`offset` (in the control's own unit) is added to the control."""

    summary = "a control arrives with an offset"

    @property
    def parameters(self):
        return (Parameter("offset", UNIT, -0.5 * self.scale, 0.5 * self.scale, 0.0),)

    def changed(self, control, values, timestep):
        return control + values
