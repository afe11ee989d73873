"""A part that spins inside a body: a fan, a spindle, a reaction wheel, the rotors of a drone that do not cancel."""

from functools import lru_cache

import mujoco
import numpy as np

from capture_cli.model.effects._kernel import Companion, call
from capture_cli.model.effects._places import ObjectEffect, source
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.parameters import Parameter
from capture_cli.model.world import World


def gyroscopic_force(qvel, qacc, axes, frame, *, momentum, timestep):
    """Generalised force (..., dof) of the torque momentum x w on a body that turns at w.

    qvel, qacc (..., dof): of what turns it; axes (..., dof, 3), in the world: what each of them turns it about.
    frame (..., 3, 3): the body's in the world; momentum (..., 3): in the body's. w is that of the middle of the step,
    going on as in the step before, of which qacc is: with that of its beginning nutation grows by itself.
    """
    in_world = (frame * momentum[..., None, :]).sum(axis=-1)  # no @, which rounds by how many it is given
    turning = ((qvel + timestep / 2 * qacc)[..., None] * axes).sum(axis=-2)
    return (axes * np.cross(in_world, turning)[..., None, :]).sum(axis=-1)


class InternalMomentum(ObjectEffect):
    """The torque - w x h on a body, w its angular velocity and h = (`x`, `y`, `z`) the angular momentum (N m s, in its
    frame) of what spins inside at a constant speed.
    """

    place, kind = "force", "body"
    reads_acceleration = True
    summary = "a part that spins inside a body that turns: a fan, a spindle, a wheel"
    where = "every body that joints turn about more than one axis"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.dofs = _turning(model)[self.number]

    @classmethod
    def suited(cls, model):
        return _turning(model)

    @property
    def parameters(self):
        # rad/s: nutation, the momentum inside over the inertia of a free body, or over the largest that a chain turns
        fastest = 10.0
        high = fastest * float(self.model.dof_M0[self.dofs].max())
        return tuple(Parameter(axis, "N m s", -high, high, 0.0) for axis in "xyz")

    def force(self, values, timestep, **_):
        def on_body(world: World) -> None:
            frame = world.xmat[:, self.number].reshape(-1, 3, 3)
            moves = world.qvel[:, self.dofs], world.qacc[:, self.dofs]
            world.qfrc_applied[:, self.dofs] += gyroscopic_force(
                *moves, world.cdof[:, self.dofs, :3], frame, momentum=values[world.rows], timestep=timestep
            )

        return on_body

    def companion(self, name, values):
        given = ["data.qvel[dofs]", "data.qacc[dofs]", "data.cdof[dofs, :3]", "data.xmat[body].reshape(3, 3)"]
        force, _ = call(name, gyroscopic_force, given, {"momentum": values})
        lines = (
            f"body, dofs = {source(self.model, 'body', self.site)}.id, {self.dofs}",
            f"data.qfrc_applied[dofs] += {force}",
        )
        return Companion((gyroscopic_force,), lines, changes=("data.qfrc_applied",))


@lru_cache(maxsize=16)
def _turning(model: mujoco.MjModel) -> dict[int, list[int]]:
    """The degrees of freedom that turn each body, for the bodies that turn about more than one axis."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    axes = data.cdof[:, :3]
    turns = axes.any(axis=1)
    found = {}
    parallel = 1e-6  # of axes, as a sine
    for body in range(1, model.nbody):
        first = model.body_dofadr[body]
        if not turns[first : first + model.body_dofnum[body]].any():
            continue  # it turns with the body that carries it, which is the place
        dofs = [d for d in _chain(model, body) if turns[d]]
        if np.linalg.matrix_rank(axes[dofs], tol=parallel) > 1:
            found[body] = dofs
    return found


def _chain(model: mujoco.MjModel, body: int) -> list[int]:
    """The degrees of freedom between the world and `body`, those of the world first."""
    dof, chain = int(model.body_dofadr[body] + model.body_dofnum[body]) - 1, []
    while dof >= 0:
        chain.insert(0, dof)
        dof = int(model.dof_parentid[dof])
    return chain
