"""Actuators on one supply, whose voltage drops with the forces that all of them give."""

import mujoco
import numpy as np

from capture_cli.model.effects._joint_force import ForceOfKernel
from capture_cli.model.effects._kernel import Companion, call
from capture_cli.model.effects._lag import Lag
from capture_cli.model.effects._linear_actuators import SCALED, linear_actuators
from capture_cli.model.effects._places import ids_source
from capture_cli.model.effects._scales import actuator_force_scale, actuator_force_unit
from capture_cli.model.effects.base import GLOBAL, Effect
from capture_cli.model.parameters import Parameter


class Weakening:
    """How many times its own size every force is, where the load was `given` in the step before.

    more: N or N m, how much more load is felt at the start than there is.
    """

    def __init__(self, *, sag, time_constant, timestep, more=0.0):
        self.sag, self.more = sag, more
        self.felt = Lag(time_constant=time_constant, timestep=timestep)
        self.size = 1.0

    def __call__(self, given):
        load = given / self.size
        if self.felt.state is None:
            self.felt.state = np.maximum(load + self.more, 0.0)
        self.size = 1 / (1 + self.sag * self.felt(load))
        return self.size


class ForceSupplySag(Effect):
    """The force of every actuator is 1 / (1 + `sag` load) of what it would be: of a servo all of it, its damping and
    its limits too, not what it is told.

    The load is the mean size of what all of them would give, N or N m, felt through a first-order lag of
    `time_constant` (s). So a voltage drops with the current: where without a lag the forces are as the voltage, they
    are by `sag` times the mean of what is given less than they would be. The load is that of the step before.
    """

    place = "force"
    summary = "actuators are weaker the more force all of them give: a supply, or a battery, that sags with currents"
    where = "the model as a whole, if it has an actuator whose force is linear: no muscle and no dcmotor"
    # a supply without capacitors sags at once
    shapes = shares = ("time_constant",)
    states = ("more",)
    states_mean = (
        "`more`: load that is felt beyond what there is, N or N m. At 1 what all actuators commonly give"
    )
    kernel = Weakening
    kernel_keeps = ("felt.state", "size")

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.fed = linear_actuators(model)
        # a slice is quicker than indices, and most models have no other actuators
        self._columns = slice(None) if len(self.fed) == model.nu else self.fed

    @classmethod
    def sites(cls, model):
        return [GLOBAL] if linear_actuators(model) else []

    @property
    def parameters(self):
        units = {actuator_force_unit(self.model, a) for a in self.fed}
        unit = units.pop() if len(units) == 1 else "N or N m"
        # Over the load at which all give the most that they commonly do; that of a servo is a guess, and mostly far
        # too much
        largest = 3.0
        return (
            Parameter("sag", "1/N" if unit == "N" else f"1/({unit})", 0.0, largest / self.most, 0.0),
            Parameter("time_constant", "s", 0.0, 0.5, 0.07),
        )

    @property
    def most(self) -> float:
        """The load when every actuator gives the most that it commonly does, N or N m."""
        return float(np.mean([actuator_force_scale(self.model, a) for a in self.fed]))

    def force(self, values, timestep, *, states=None, **_):
        more = np.zeros(len(values)) if states is None else self.most * states[:, 0]
        return ForceOfKernel(self, self.coefficients(values) | {"more": more}, timestep)

    def read(self, world, field):
        # the mean, in a third of the time that its method takes for so few numbers
        return np.add.reduce(np.abs(world.actuator_force[:, self._columns]), axis=1) / len(self.fed)

    def add(self, world, term):
        size = term[:, None, None]
        for field in SCALED:
            world.vary(field)[:, self._columns] *= size

    def companion(self, name, values):
        size, state = call(name, Weakening, ["np.abs(data.actuator_force[fed]).mean()"], self.numbers(values))
        fields = tuple(f"model.{field}" for field in SCALED)
        lines = [
            f"fed = {ids_source(self.model, 'actuator', self.fed)}",
            f"size = {size}",
            *(f"{field}[fed] *= size" for field in fields),
        ]
        return Companion((Lag, Weakening), tuple(lines), state, fields)
