"""Actuators on one supply, whose voltage drops with what all of them draw."""

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.model.effects._actuator_effect import ActuatorEffect, without_target
from capture_cli.model.effects._kernel import OWN_STEP, Companion, bound, call
from capture_cli.model.effects._lag import Lag
from capture_cli.model.effects._scales import control_scale
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.parameters import Parameter


@frozen
class SETTINGS:
    largest: float = 1.0  # of a control, where all are the largest that they commonly are: nothing arrives
    forgotten: float = 8.0  # time constants, after which 3e-4 of a load is left in the voltage


class Sagging:
    """How many times its own size a control arrives, under `load`."""

    def __init__(self, *, sag, time_constant, timestep):
        self.sag = sag
        self.felt = Lag(time_constant=time_constant, timestep=timestep)

    def __call__(self, load):
        return 1 - self.sag * self.felt(load)


class ControlSupplySag(ActuatorEffect):
    """Controls arrive 1 - `sag` (1/ctrl) load times as large, with load the mean of all their sizes, felt through a
    first-order lag of `time_constant` (s): a battery, or a power supply that is too weak.
    """

    summary = (
        "controls arrive smaller the more all actuators draw: a battery or a supply that sags under load"
    )
    where = "the model as a whole, if controls are forces or voltages"
    shapes = ("time_constant",)
    remembers = f"{SETTINGS.forgotten:g} `time_constant`"

    @classmethod
    def sites(cls, model: mujoco.MjModel) -> list[str]:
        return [GLOBAL] if cls.together(model) else []

    @classmethod
    def together(cls, model: mujoco.MjModel) -> list[str]:
        """Those whose control is no target of a servo."""
        return without_target(model)

    @property
    def parameters(self):
        full = np.mean([control_scale(self.model, a) for a in self.actuators])
        return (
            Parameter("sag", "1/ctrl", 0.0, SETTINGS.largest / full, 0.0),
            Parameter("time_constant", "s", 0.01, 0.5, 0.07),
        )

    def drive(self, controls, values, timestep, **_):
        controls = controls.copy()
        load = np.abs(controls[..., self.columns]).mean(axis=-1)
        size = bound(Sagging, self.coefficients(values), timestep)
        for step in range(controls.shape[1]):
            controls[:, step, self.columns] *= size(load[:, step])[:, None]
        return controls

    def memory(self, values):
        sag, time_constant = values.T
        return SETTINGS.forgotten * float(np.max(time_constant, where=sag > 0, initial=0.0))

    def companion(self, name, values):
        size, state = call(name, Sagging, ["load"], self.numbers(values), OWN_STEP)
        lines = (
            f"at = {self.columns_source}",
            "load = np.abs(data.ctrl[at]).mean()",
            f"size = {size}",
            "data.ctrl[at] *= size",
        )
        return Companion((Lag, Sagging), lines, state)
