"""A motor constant that depends on the rotor's angle: mutual torque ripple, a weak phase, an eccentric pulley."""

from capture_cli.model.effects._kernel import Companion, call
from capture_cli.model.effects._linear_actuators import SCALED, OnJoint
from capture_cli.model.effects._periodic_force import AlongPosition
from capture_cli.model.effects._places import source
from capture_cli.model.parameters import Parameter


class TorqueRipple(OnJoint, AlongPosition):
    """The actuator's force is 1 + `sine` sin(2 pi q / `period`) + `cosine` cos(2 pi q / `period`) times that of the
    model, q (m or rad) the position of its joint: without current there is none, which is what cogging is not.

    Gain, bias and force range are scaled together, in the step in which q is so: all of a servo's force ripples, its
    damping too, which MuJoCo integrates implicitly. What limits the force at the joint does not.
    """

    summary = (
        "a motor's force that is larger at some positions: a weak phase, commutation, an eccentric pulley"
    )

    @property
    def parameters(self):
        most = 0.7  # of each amplitude: both together stay below 1, where the force would change its sign
        return (
            Parameter("sine", "1", -most, most, 0.0),
            Parameter("cosine", "1", -most, most, 0.0),
            self.period,
        )

    def carrier(self, actuator_force):
        return self.model.actuator_gear[self.actuator, 0] * actuator_force[..., self.actuator]

    def add(self, world, term):
        for field in SCALED:
            world.vary(field)[:, self.actuator] *= 1 + term[:, None]

    def companion(self, name, values):
        joint = source(self.model, "joint", self.joint_name)
        ripple, _ = call(name, self.kernel, [f"data.qpos[{joint}.qposadr]"], self.numbers(values))
        fields = tuple(f"model.{field}" for field in SCALED)
        lines = [
            f"motor = {source(self.model, 'actuator', self.site)}.id",
            f"ripple = {ripple}",
            *(f"{field}[motor] *= 1 + ripple" for field in fields),
        ]
        return Companion((self.kernel,), tuple(lines), changes=fields)
