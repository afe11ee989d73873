"""Lift on what spins as it flies."""

import mujoco
import numpy as np

from capture_cli.model.effects._kernel import Companion, call
from capture_cli.model.effects._places import ObjectEffect, source
from capture_cli.model.effects._rotation import body_vectors
from capture_cli.model.effects._scales import FREE
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.parameters import Parameter
from capture_cli.model.world import World


def magnus_lift(qpos, qvel, *, lift, centre):
    """Force (..., 3) in the world: lift (spin x velocity of the centre of mass), which is at `centre` (3,).

    qpos (..., 7), qvel (..., 6): of the free joint.
    """
    spin = body_vectors(qpos[..., 3:], qvel[..., 3:])
    arm = body_vectors(qpos[..., 3:], np.broadcast_to(centre, spin.shape))
    return lift * np.cross(spin, qvel[..., :3] + np.cross(spin, arm))


class MagnusLift(ObjectEffect):
    """The force `lift` x (spin x velocity) at the centre of mass of a free body, against a medium at rest.

    For a ball of volume V in a medium of density rho, `lift` is of the order of rho V (kg).
    """

    place, kind = "force", "joint"
    summary = "lift on a free body that spins as it flies"
    where = "every free joint"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.body = int(model.jnt_bodyid[self.number])
        self.dof, self.position = int(model.jnt_dofadr[self.number]), int(model.jnt_qposadr[self.number])

    @classmethod
    def suited(cls, model):
        return np.flatnonzero(model.jnt_type == FREE)

    @property
    def parameters(self):
        high = 0.1 * float(self.model.body_mass[self.body])
        return (Parameter("lift", "kg", -high, high, 0.0),)

    def force(self, values, timestep, **_):
        centre = self.model.body_ipos[self.body]

        def on_body(world: World) -> None:
            qpos = world.qpos[:, self.position : self.position + 7]
            qvel = world.qvel[:, self.dof : self.dof + 6]
            lift = magnus_lift(qpos, qvel, lift=values[world.rows], centre=centre)
            world.xfrc_applied[:, self.body, :3] += lift

        return on_body

    def companion(self, name, values):
        given = ["data.qpos[at : at + 7]", "data.qvel[dof : dof + 6]"]
        numbers = {"lift": values[0], "centre": self.model.body_ipos[self.body]}
        lift, _ = call(name, magnus_lift, given, numbers)
        lines = (
            f"joint = {source(self.model, 'joint', self.site)}",
            "at, dof = joint.qposadr[0], joint.dofadr[0]",
            f"data.xfrc_applied[joint.bodyid[0], :3] += {lift}",
        )
        return Companion((magnus_lift,), lines, changes=("data.xfrc_applied",))
