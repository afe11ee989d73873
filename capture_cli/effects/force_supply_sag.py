"""Actuators on one supply, whose voltage drops with the forces that all of them give."""

from __future__ import annotations

import mujoco
import numpy as np

from capture_cli.effects._joint_force import ForceOfKernel
from capture_cli.effects._kernel import Companion, call
from capture_cli.effects._lag import Lag
from capture_cli.effects._linear_actuators import BIAS, GAIN, LIMITS, SCALED, is_servo, linear_actuators
from capture_cli.effects._places import reference
from capture_cli.effects._sagging import TIME_CONSTANT, Sagging
from capture_cli.effects._scales import actuator_force_scale, actuator_force_unit
from capture_cli.effects.base import GLOBAL, Effect
from capture_cli.parameters import Parameter
from capture_cli.sim.object_names import object_name

LARGEST = 2.0  # of the load at which nothing arrives, where all give the most that they commonly do


class ForceSupplySag(Effect):
    """What feeds the actuators is 1 - `sag` load times what it should be, with load the mean size of all their forces,
    N or N m, felt through a first-order lag of `time_constant` (s): steadily, 1 / (1 + sag load) of the load that the
    model would give.

    A force or a voltage that is told arrives that much smaller; of a servo all of the force is, its damping and its
    limits too, as it is the target that is told. Forces are those of the step before.
    """

    place = "force"
    summary = "actuators are weaker the more force all of them give: a supply, or a battery, that sags with currents"
    where = "the model as a whole, if it has an actuator whose force is linear: no muscle and no dcmotor"
    shapes = ("time_constant",)
    kernel = Sagging

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.fed = linear_actuators(model)
        self.servos = [a for a in self.fed if is_servo(model, a)]

    @classmethod
    def sites(cls, model):
        return [GLOBAL] if linear_actuators(model) else []

    @property
    def parameters(self):
        units = {actuator_force_unit(self.model, a) for a in self.fed}
        unit = units.pop() if len(units) == 1 else "N or N m"
        most = np.mean([actuator_force_scale(self.model, a) for a in self.fed])
        return (
            Parameter("sag", "1/N" if unit == "N" else f"1/({unit})", 0.0, LARGEST / most, 0.0),
            TIME_CONSTANT,
        )

    def force(self, values, timestep, **_):
        return ForceOfKernel(self, self.coefficients(values), timestep)

    def read(self, world, field):
        return np.abs(world.actuator_force[:, self.fed]).mean(axis=1)

    def add(self, world, term):
        world.vary(GAIN)[:, self.fed] *= term[:, None, None]
        world.vary(BIAS)[:, self.servos] *= term[:, None, None]
        world.vary(LIMITS)[:, self.servos] *= term[:, None, None]

    def companion(self, name, values):
        numbers = {n: v[0] for n, v in self.coefficients(values[None]).items()}
        size, state = call(name, Sagging, ["load"], numbers)
        lines = [
            f"fed = {self._ids(self.fed)}",
            "load = np.abs(data.actuator_force[fed]).mean()",
            f"size = {size}",
            f"model.{GAIN}[fed] *= size",
        ]
        if self.servos:
            lines += [f"servos = {self._ids(self.servos)}"]
            lines += [f"model.{field}[servos] *= size" for field in (BIAS, LIMITS)]
        return Companion((Lag, Sagging), tuple(lines), state, tuple(f"model.{field}" for field in SCALED))

    def _ids(self, actuators: list[int]) -> str:
        """Source of a list of them."""
        names = [reference(self.model, "actuator", object_name(self.model, "actuator", a)) for a in actuators]
        return f"[{', '.join(f'model.actuator({name}).id' for name in names)}]"
