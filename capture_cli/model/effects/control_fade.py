"""A control that arrives smaller, or larger, the longer the machine runs."""

import numpy as np

from capture_cli.model.effects._actuator_effect import ActuatorEffect
from capture_cli.model.effects._growth import TIME_CONSTANT, growing_companion, grown
from capture_cli.model.parameters import Parameter


class ControlFade(ActuatorEffect):
    """Controls arrive 1 + `change` (1 - e^(-t / `time_constant`)) times as large, t since the episode began: magnets
    that warm, a battery that sags.
    """

    summary = "a control arrives smaller, or larger, the longer the machine runs"
    shapes = ("time_constant",)
    kernel = staticmethod(grown)
    parameters = (Parameter("change", "1", -1.0, 2.0, 0.0), TIME_CONSTANT)  # to none, or three times

    def drive(self, controls, values, timestep, *, elapsed=0.0, **_):
        time = np.reshape(elapsed, (-1, 1)) + timestep * np.arange(controls.shape[1])
        growth = grown(time, **{n: v[:, None] for n, v in self.coefficients(values).items()})
        controls = controls.copy()
        controls[:, :, self.columns] *= growth[..., None]
        return controls

    def companion(self, name, values):
        at = f"at = {self.columns_source}"
        return growing_companion(name, grown, self.numbers(values), at, ["data.ctrl"])
