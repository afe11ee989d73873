"""A part that spins inside a body: a fan, a reaction wheel, the rotors of a drone that do not cancel."""

from __future__ import annotations

import mujoco
import numpy as np

from capture_cli.effects._kernel import Companion, call
from capture_cli.effects._places import reference, site_id, site_name
from capture_cli.effects.base import GLOBAL, Effect
from capture_cli.parameters import Parameter
from capture_cli.sim.engine import World

FREE, BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
FASTEST = 10.0  # rad/s: nutation of the body, its momentum inside over its own inertia


def gyroscopic_torque(qvel, *, momentum):
    """Torque (..., 3) in the body's frame: - turning x momentum. qvel (..., 3): of the turning, in that frame."""
    return -np.cross(qvel, momentum)


class InternalMomentum(Effect):
    """The torque - w x h on a free body, w its angular velocity and h = (`x`, `y`, `z`) the angular momentum (N m s, in
    its frame) of what spins inside at a constant speed.
    """

    place = "force"
    summary = "a part that spins inside a body that turns: a fan, a wheel"
    where = "every free joint, and every ball joint to the world"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        joint = site_id(model, "joint", site)
        self.is_free = model.jnt_type[joint] == FREE
        self.dof = int(model.jnt_dofadr[joint]) + (3 if self.is_free else 0)

    @classmethod
    def sites(cls, model):
        return [site_name(model, "joint", j) for j in range(model.njnt) if _turns_in_the_world(model, j)]

    @property
    def parameters(self):
        high = FASTEST * float(self.model.dof_M0[self.dof : self.dof + 3].max())
        return tuple(Parameter(axis, "N m s", -high, high, 0.0) for axis in "xyz")

    def force(self, values, timestep, **_):
        dofs = slice(self.dof, self.dof + 3)

        def on_body(world: World) -> None:
            world.qfrc_applied[:, dofs] += gyroscopic_torque(world.qvel[:, dofs], momentum=values[world.rows])

        return on_body

    def companion(self, name, values):
        torque, _ = call(name, gyroscopic_torque, ["data.qvel[dof : dof + 3]"], {"momentum": values})
        joint = f"model.joint({reference(self.model, 'joint', self.site)})"
        turning = " + 3" if self.is_free else ""
        lines = (f"dof = {joint}.dofadr[0]{turning}", f"data.qfrc_applied[dof : dof + 3] += {torque}")
        return Companion((gyroscopic_torque,), lines, changes=("data.qfrc_applied",))


def _turns_in_the_world(model: mujoco.MjModel, joint: int) -> bool:
    """Whether its angular velocity is that of its body, rather than from another that moves."""
    kind, body = model.jnt_type[joint], model.jnt_bodyid[joint]
    fixed = model.body_weldid[model.body_parentid[body]] == 0 and model.body_jntnum[body] == 1
    return bool(kind == FREE or (kind == BALL and fixed))
