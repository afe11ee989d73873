"""Effects that the catalogue does not have. `diagnose` is to say so, not to call them something else."""

from __future__ import annotations

import numpy as np

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.parameters import Parameter
from capture_cli.model.world import World

WALK_STEP = 0.1  # s, between the knots of the random walk
WALK_KNOTS = 40


class _OneForce(JointEffect):
    """A force on a joint with one amplitude, the joint's characteristic force at most."""

    place = "force"
    summary = "outside the catalogue"

    @property
    def parameters(self):
        return (Parameter("size", self.unit("N", "N m"), 0.0, self.characteristic_force, 0.0),)


class TanhCoupling(_OneForce):
    """-`size` tanh(3 q) v / (characteristic speed): damping on one side, driving on the other."""

    def force(self, values, timestep, **_):
        def coupled(world: World) -> None:
            rate = world.qvel[:, self.dof] / self.characteristic_speed
            force = values[world.rows, 0] * np.tanh(3 * world.qpos[:, self.dof]) * rate
            world.qfrc_applied[:, self.dof] -= force

        return coupled


class RippledDamping(_OneForce):
    """Damping that goes up and down with position, three times over the joint's travel."""

    def force(self, values, timestep, **_):
        def rippled(world: World) -> None:
            rate = world.qvel[:, self.dof] / self.characteristic_speed
            ripple = 1 + np.sin(6 * np.pi * world.qpos[:, self.dof] / self.travel)
            world.qfrc_applied[:, self.dof] -= values[world.rows, 0] * ripple * rate

        return rippled


class RandomWalk(_OneForce):
    """A disturbance that wanders: a random walk with straight lines between its knots, another in each episode."""

    def force(self, values, timestep, **_):
        steps = np.random.default_rng(len(values)).standard_normal((len(values), WALK_KNOTS))
        walk = np.cumsum(steps, axis=1) / np.sqrt(WALK_KNOTS)

        def wandering(world: World) -> None:
            at = world.time.ravel() / WALK_STEP
            knot = np.minimum(at.astype(int), WALK_KNOTS - 2)
            share = at - knot
            force = (1 - share) * walk[world.rows, knot] + share * walk[world.rows, knot + 1]
            world.qfrc_applied[:, self.dof] += values[world.rows, 0] * force

        return wandering


class Ratchet(_OneForce):
    """Teeth that hold back on the way up alone, eight over the joint's travel; down they are not felt."""

    def force(self, values, timestep, **_):
        def held_back(world: World) -> None:
            tooth = np.maximum(np.sin(8 * np.pi * world.qpos[:, self.dof] / self.travel), 0.0)
            upwards = (1 + np.tanh(world.qvel[:, self.dof] / (0.02 * self.characteristic_speed))) / 2
            world.qfrc_applied[:, self.dof] -= values[world.rows, 0] * tooth * upwards

        return held_back


OUTSIDE = {
    "tanh-coupling": TanhCoupling,
    "rippled-damping": RippledDamping,
    "random-walk": RandomWalk,
    "ratchet": Ratchet,
}
# Effects of the catalogue that are planted while the catalogue is without them: (machine, effect, site).
LEFT_OUT = (
    ("slider", "position-dependent-friction", "x"),
    ("cart_pole", "payload", "pole"),
    ("arm", "payload", "fore"),
    ("pan_tilt", "position-dependent-friction", "pan"),
    ("finger", "tendon-friction", "flexor"),
    ("puck", "cubic-drag", "y"),
)
