"""A control that arrives larger or smaller in reverse."""

import numpy as np

from capture_cli.model.effects._actuator_effect import ActuatorEffect
from capture_cli.model.effects._places import site_id
from capture_cli.model.parameters import Parameter


def reversed_gain(control, *, change):
    """control (1 + change) where it is negative."""
    return np.where(control < 0, control * (1 + change), control)


class ControlReverseGain(ActuatorEffect):
    """Negative controls arrive (1 + `change`) times as large: a propeller, a cylinder with a rod on one side."""

    summary = "a control arrives larger or smaller in reverse"
    where = "every actuator that has a reverse"
    kernel = staticmethod(reversed_gain)
    parameters = (Parameter("change", "1", -1.0, 2.0, 0.0),)  # from none to three times

    @classmethod
    def sites(cls, model):
        ids = ((name, site_id(model, "actuator", name)) for name in super().sites(model))
        return [n for n, a in ids if not model.actuator_ctrllimited[a] or model.actuator_ctrlrange[a, 0] < 0]
