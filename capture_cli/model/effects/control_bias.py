"""A control with an offset."""

from capture_cli.model.effects._actuator_effect import UNIT, ActuatorEffect
from capture_cli.model.parameters import Parameter


def offset_control(control, *, offset):
    """control + offset."""
    return control + offset


class ControlBias(ActuatorEffect):
    """`offset` (in the control's own unit) is added to the control."""

    summary = "a control arrives with an offset"
    kernel = staticmethod(offset_control)

    @property
    def parameters(self):
        return (Parameter("offset", UNIT, -self.scale, self.scale, 0.0),)
