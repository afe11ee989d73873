"""Effects that the catalogue does not have. `diagnose` is to say so, not to call them something else."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._joint_effect import JointEffect
from capture_cli.parameters import Parameter
from capture_cli.sim.engine import World

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


class BoucWen(_OneForce):
    """Hysteretic friction (Bouc 1967, Wen 1976): a spring that yields, z' = (v - |v| z / reach) / reach."""

    def force(self, values, timestep, **_):
        state = np.zeros(len(values))
        reach = 0.05 * self.travel

        def yielding(world: World) -> None:
            rows, rate = world.rows, world.qvel[:, self.dof]
            state[rows] += timestep * (rate - np.abs(rate) * state[rows]) / reach
            world.qfrc_applied[:, self.dof] -= values[rows, 0] * state[rows]

        return yielding


OUTSIDE = {
    "tanh-coupling": TanhCoupling,
    "rippled-damping": RippledDamping,
    "random-walk": RandomWalk,
    "bouc-wen": BoucWen,
}
# Effects of the catalogue that are planted while the catalogue is without them: (machine, effect, site).
LEFT_OUT = (
    ("slider", "position-dependent-friction", "x"),
    ("cart_pole", "payload", "pole"),
    ("arm", "payload", "fore"),
    ("pan_tilt", "position-dependent-friction", "pan"),
    ("puck", "cubic-drag", "y"),
)
