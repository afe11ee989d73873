"""A control that arrives larger or smaller than commanded."""

from capture_cli.model.effects._actuator_effect import ActuatorEffect
from capture_cli.model.parameters import Parameter


def amplified(control, *, change):
    """control (1 + change)."""
    return control * (1 + change)


class ControlGain(ActuatorEffect):
    """The control arrives (1 + `change`) times as large."""

    summary = "a control arrives larger or smaller than commanded"
    kernel = staticmethod(amplified)
    parameters = (Parameter("change", "1", -1.0, 2.0, 0.0),)  # from none to three times
