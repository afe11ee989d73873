"""A motor that gives the less, the faster it turns."""

import numpy as np

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects._joint_force import ForceOfKernel
from capture_cli.model.effects._kernel import Companion, call
from capture_cli.model.effects._limited import UNLIMITED, unlimited_at
from capture_cli.model.effects._linear_actuators import OnJoint
from capture_cli.model.effects._places import source
from capture_cli.model.effects._scales import actuator_force_scale, actuator_force_unit
from capture_cli.model.parameters import Parameter

LARGEST = 4.0  # stall force, over what the actuator is commonly asked for
# Speed without load, over the largest that is commonly seen. Beyond, it is a limit of the force alone.
SLOWEST, FASTEST = 0.3, 20.0


def motor_range(speed, *, stall, no_load_speed):
    """The least and the largest force at a speed: what drives falls along the line, what brakes does not."""
    shares = (np.clip(1 - way * speed / no_load_speed, 0.0, 1.0) for way in (-1, 1))
    low, high = (np.where(stall < UNLIMITED, np.minimum(stall, UNLIMITED) * s, UNLIMITED) for s in shares)
    return -low, high


class TorqueSpeedLimit(OnJoint, JointEffect):
    """The actuator's force is no more than `stall` (1 - w / `no_load_speed`) where it drives, and than `stall` where it
    brakes; w is the speed of its joint times its gear. With `stall` at its null, the end of its range, nothing is cut
    off.

    What a motor can give at the voltage that its amplifier has. A limit that no force reaches moves nothing.
    """

    place = "force"
    summary = "a motor gives the less, the faster it turns: the line from stall torque to no-load speed"
    has_threshold = True
    shapes = ("no_load_speed",)
    kernel = staticmethod(motor_range)

    @property
    def parameters(self):
        force = actuator_force_scale(self.model, self.actuator)
        speed = abs(self.model.actuator_gear[self.actuator, 0]) * self.characteristic_speed
        return (
            Parameter(
                "stall",
                actuator_force_unit(self.model, self.actuator),
                0.05 * force,
                LARGEST * force,
                LARGEST * force,
            ),
            Parameter(
                "no_load_speed", self.unit("m/s", "rad/s"), SLOWEST * speed, FASTEST * speed, 1.2 * speed
            ),
        )

    def coefficients(self, values):
        null = self.parameters[0].nominal
        return {"stall": unlimited_at(null, values[:, 0]), "no_load_speed": values[:, 1]}

    def force(self, values, timestep, **_):
        return ForceOfKernel(self, self.coefficients(values), timestep)

    def read(self, world, field):
        gear = world.vary("actuator_gear")[:, self.actuator, 0]  # which a parameter may have changed
        return gear * world.qvel[:, self.dof]

    def add(self, world, term):
        low, high = term
        limited, own = (
            world.vary(f"actuator_force{name}")[:, self.actuator] for name in ("limited", "range")
        )
        own[~limited.astype(bool)] = -UNLIMITED, UNLIMITED
        own[:, 0], own[:, 1] = np.maximum(own[:, 0], low), np.minimum(own[:, 1], high)
        limited[...] = True

    def companion(self, name, values):
        joint = source(self.model, "joint", self.joint_name)
        speed = f"model.actuator_gear[motor, 0] * data.qvel[{joint}.dofadr[0]]"
        given, _ = call(name, motor_range, [speed], self.numbers(values))
        lines = (
            f"motor = {source(self.model, 'actuator', self.site)}.id",
            f"low, high = {given}",
            "if not model.actuator_forcelimited[motor]:",
            "    model.actuator_forcelimited[motor] = True",
            f"    model.actuator_forcerange[motor] = -{UNLIMITED!r}, {UNLIMITED!r}",
            "own = model.actuator_forcerange[motor]",
            "model.actuator_forcerange[motor] = max(own[0], low), min(own[1], high)",
        )
        fields = ("model.actuator_forcelimited", "model.actuator_forcerange")
        return Companion((motor_range,), lines, changes=fields)
