"""Lift on what spins as it flies."""

from __future__ import annotations

import mujoco
import numpy as np

from capture_cli.effects._places import site_id, site_name
from capture_cli.effects._rotation import body_vectors
from capture_cli.effects.base import GLOBAL, Effect
from capture_cli.parameters import Parameter
from capture_cli.sim.engine import World

FREE = int(mujoco.mjtJoint.mjJNT_FREE)


class MagnusLift(Effect):
    """The force `lift` x (spin x velocity) at the centre of mass of a free body, against a medium at rest.

    For a ball of volume V in a medium of density rho, `lift` is of the order of rho V (kg).
    """

    place = "force"
    summary = "lift on a free body that spins as it flies"
    where = "every free joint"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        joint = site_id(model, "joint", site)
        self.body = int(model.jnt_bodyid[joint])
        self.dof, self.position = int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])

    @classmethod
    def sites(cls, model):
        return [site_name(model, "joint", j) for j in range(model.njnt) if model.jnt_type[j] == FREE]

    @property
    def parameters(self):
        high = 0.1 * float(self.model.body_mass[self.body])
        return (Parameter("lift", "kg", -high, high, 0.0),)

    def force(self, values, timestep):
        centre = self.model.body_ipos[self.body]

        def lift(world: World) -> None:
            frame = world.qpos[:, self.position + 3 : self.position + 7]
            spin = body_vectors(frame, world.qvel[:, self.dof + 3 : self.dof + 6])
            arm = body_vectors(frame, np.broadcast_to(centre, spin.shape))
            velocity = world.qvel[:, self.dof : self.dof + 3] + np.cross(spin, arm)
            world.xfrc_applied[:, self.body, :3] += values[world.rows] * np.cross(spin, velocity)

        return lift
