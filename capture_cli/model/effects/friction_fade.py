"""Friction that falls, or grows, the longer the machine runs."""

from capture_cli.model.effects._growth import TIME_CONSTANT, growing, growing_companion, grown
from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects._joint_force import DAMPING, FRICTION
from capture_cli.model.effects._places import source
from capture_cli.model.parameters import Parameter


class FrictionFade(JointEffect):
    """The joint's dry friction and damping become 1 + `change` (1 - e^(-t / `time_constant`)) times as large, t since
    the episode began: grease that warms.
    """

    place = "force"
    summary = "friction and damping that fall, or grow, the longer the machine runs"
    shapes = ("time_constant",)
    parameters = (Parameter("change", "1", -1.0, 2.0, 0.0), TIME_CONSTANT)  # to none, or three times

    def force(self, values, timestep, *, began=0.0, **_):
        return growing(grown, self.coefficients(values), began, (FRICTION, DAMPING), self.dof)

    def companion(self, name, values):
        at = f"dof = {source(self.model, 'joint', self.site)}.dofadr"
        fields = [f"model.{field}" for field in (FRICTION, DAMPING)]
        return growing_companion(name, grown, self.numbers(values), at, fields)
