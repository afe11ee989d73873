"""A force that is always there."""

import mujoco

from capture_cli.model.effects._kernel import Companion, number
from capture_cli.model.effects._places import ObjectEffect, source
from capture_cli.model.effects._scales import FREE, GRAVITY, HINGE, SLIDE, characteristic_force
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.parameters import Parameter
from capture_cli.model.world import World


class ConstantForce(ObjectEffect):
    """A constant `force` (N or N m) on a hinge or slide joint; on a free body, its components in the world.

    It stands for a cable, a counterweight, a spring's preload or an offset of the drive. On one slide joint
    it looks the same as gravity that leans.
    """

    place, kind = "force", "joint"
    summary = "a force that is always there: a cable, a counterweight, a preload"
    where = "every hinge, slide and free joint"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.joint = self.number  # as other effects on a joint have it
        self.is_free = model.jnt_type[self.joint] == FREE

    @classmethod
    def suited(cls, model):
        return [j for j in range(model.njnt) if model.jnt_type[j] in (HINGE, SLIDE, FREE)]

    @property
    def parameters(self):
        if self.is_free:
            weight = GRAVITY * float(self.model.body_subtreemass[self.model.jnt_bodyid[self.number]])
            return tuple(Parameter(axis, "N", -weight, weight, 0.0) for axis in "xyz")
        high = characteristic_force(self.model, self.number)
        unit = "N m" if self.model.jnt_type[self.number] == HINGE else "N"
        return (Parameter("force", unit, -high, high, 0.0),)

    def force(self, values, timestep, **_):
        body, dof = self.model.jnt_bodyid[self.number], self.model.jnt_dofadr[self.number]

        def on_joint(world: World) -> None:
            world.qfrc_applied[:, dof] += values[world.rows, 0]

        def on_body(world: World) -> None:
            world.xfrc_applied[:, body, :3] += values[world.rows]

        return on_body if self.is_free else on_joint

    def companion(self, name, values):
        joint = source(self.model, "joint", self.site)
        if self.is_free:
            lines = (
                f"body = {joint}.bodyid[0]",
                f"data.xfrc_applied[body, :3] += {number(values)}",
            )
            return Companion((), lines, changes=("data.xfrc_applied",))
        line = f"data.qfrc_applied[{joint}.dofadr] += {number(values[0])}"
        return Companion((), (line,), changes=("data.qfrc_applied",))
