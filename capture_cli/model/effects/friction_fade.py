"""Friction that falls, or grows, the longer the machine runs."""

import numpy as np

from capture_cli.model.effects._elapsed import Elapsed
from capture_cli.model.effects._fade import TIME_CONSTANT, grown
from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects._joint_force import DAMPING, FRICTION
from capture_cli.model.effects._kernel import Companion, call
from capture_cli.model.effects._places import source
from capture_cli.model.parameters import Parameter


class FrictionFade(JointEffect):
    """The joint's dry friction and damping become 1 + `change` (1 - e^(-t / `time_constant`)) times as large, t since
    the episode began: grease that warms.
    """

    place = "force"
    summary = "friction and damping that fall, or grow, the longer the machine runs"
    shapes = ("time_constant",)
    parameters = (Parameter("change", "1", -0.9, 2.0, 0.0), TIME_CONSTANT)

    def force(self, values, timestep, *, began=0.0, **_):
        change, time_constant = values.T
        began = np.broadcast_to(began, len(values))

        def force(world):
            rows = world.rows
            growth = grown(world.time - began[rows], change=change[rows], time_constant=time_constant[rows])
            for field in (FRICTION, DAMPING):
                world.vary(field)[:, self.dof] *= growth

        return force

    def companion(self, name, values):
        elapsed, state = call(name, Elapsed, ["data.time"], {})
        growth, _ = call(name, grown, ["elapsed"], self.numbers(values))
        fields = [f"model.{field}" for field in (FRICTION, DAMPING)]
        lines = [
            f"dof = {source(self.model, 'joint', self.site)}.dofadr",
            f"elapsed = {elapsed}",
            f"growth = {growth}",
            *(f"{field}[dof] *= growth" for field in fields),
        ]
        return Companion((Elapsed, grown), tuple(lines), state, tuple(fields))
