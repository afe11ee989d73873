"""A machine that stands on something that gives: a table, a stand, a vehicle on its springs."""

from functools import lru_cache

import mujoco
import numpy as np

from capture_cli.model.effects._joint_force import gives_way
from capture_cli.model.effects._kernel import Companion, call, kept
from capture_cli.model.effects._scales import driven_joints, moving_bodies
from capture_cli.model.effects._vibration import ForceShakenBefore, Shaken, Vibration, VibrationEffect
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.parameters import Parameter
from capture_cli.model.world import World

AXES = ("x", "y", "z")


class SprungBase(Vibration):
    """Acceleration x'' of a base that what moves on it pushes.

    With m_i a_i the masses that move and their accelerations along the axis as seen from the base, M their sum, b the
    mean acceleration and M_b the mass of the base, (M_b + M) x'' + c x' + k x = -M b. mobility u: M / (M_b + M).

    What holds the masses back is x'' times their momenta per speed, J; it takes g x'' of b, g = J' (mass matrix)^-1 J
    / M. So x'' = -(u (b + g x'') + p) / (R - u g), where b + g x'', what b were on a base that stays, is not known
    before the step: it is taken to go on as in the two before. The base moves by the b that came of it. A motion that
    is recorded does not answer to x'': along it g is 0, or x'' would run away.
    """

    def __init__(self, *, mobility, timestep, **rest):
        super().__init__(timestep=timestep, **rest)
        self.mobility = mobility
        self.before = self.staying = None  # momentum, kg m/s, and b + g x'', m/s^2, of the step before
        self.accelerates = 0.0  # x'', m/s^2

    def __call__(self, momentum, force, mass, gives):
        """x''. momentum: of what moves, seen from the base; force: its rate, which counts at the first step alone;
        gives: g, of the step before.
        """
        if self.before is None:
            goes_on = force / mass
        else:
            mean = (momentum - self.before) / (self.timestep * mass)
            self.move(self.mobility * mean)
            stayed = mean + gives * self.accelerates
            goes_on = stayed if self.staying is None else 2 * stayed - self.staying
            self.staying = stayed
        self.before = np.array(momentum)
        resists = self.resists - self.mobility * gives
        self.accelerates = -(self.mobility * goes_on + self.pulled()) / resists
        return self.accelerates


def momentum_along(model, axis, cdof, subtree_com, body_subtreemass):
    """kg, or kg m: momentum along the axis of the world, per unit of each qvel, (..., nv)."""
    body = model.dof_bodyid
    arm = subtree_com[..., body, :] - subtree_com[..., model.body_rootid[body], :]
    one, two = (axis + 1) % 3, (axis + 2) % 3
    turned = cdof[..., one] * arm[..., two] - cdof[..., two] * arm[..., one]
    return body_subtreemass[..., body] * (cdof[..., 3 + axis] + turned)


def centre_along(mass, position, bodies, axis):
    """m: of the masses of `bodies`, along the axis of the world; mass (..., body), position (..., body, 3)."""
    own = mass[..., bodies]
    return (own * position[..., bodies, axis]).sum(axis=-1) / own.sum(axis=-1)


class BaseCompliance(VibrationEffect):
    """The base is free to move along one axis of the world, on springs: at `frequency` (Hz) and with `damping_ratio` of
    the critical damping where the machine is held. Of the mass on the springs the share `mobility` moves on the base.

    Everything is seen from the base, but for accelerometers, which show its acceleration as well: sensors that stand
    elsewhere are outside of this.
    """

    place = "force"
    reads_acceleration = True
    summary = "the machine stands on something that gives: a table, a stand, a vehicle on its springs"
    where = "each axis of the world along which an actuator can push the base"
    kernel = SprungBase
    kernel_keeps = ("displaced", "rate", "before", "staying", "accelerates")

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.axis = AXES.index(site)
        self.moving = moving_bodies(model)
        self.accelerometers = _accelerometers(model)

    @classmethod
    def sites(cls, model):
        return [AXES[k] for k in _pushed(model)]

    @property
    def parameters(self):
        most = 0.8  # of what stands on the springs: a base of a quarter of what moves on it
        return (Parameter("mobility", "1", 0.0, most, 0.0), *self.swinging)

    def shaken_in(self, log):
        model = self.model
        if any(joint not in log.seen for joint in range(model.njnt)):
            return None
        paths = np.stack([log.seen[joint].path for joint in range(model.njnt)], axis=1)
        data, parts = mujoco.MjData(model), np.full((len(paths), len(self.moving)), np.nan)
        for step in np.flatnonzero(np.isfinite(paths).all(axis=1)):
            data.qpos[model.jnt_qposadr] = paths[step]
            mujoco.mj_kinematics(model, data)
            parts[step] = data.xipos[self.moving, self.axis]
        known, joints = log.seen[0], [log.seen[joint] for joint in range(model.njnt)]
        weights = model.body_mass[self.moving] / model.body_mass[self.moving].sum()
        begun, begun_sd = np.zeros((len(known.stretches), len(weights))), np.zeros(len(known.stretches))
        for number, steps in enumerate(known.stretches):
            measured = np.isfinite(parts[steps]).all(axis=1)
            if measured.any():
                moved = self._moved(paths[steps][np.argmax(measured)])
                begun[number] = moved @ [own.begun[number] for own in joints]
                begun_sd[number] = np.linalg.norm(weights @ moved * [own.begun_sd[number] for own in joints])
        moved = weights @ self._moved(model.qpos0[model.jnt_qposadr])
        noise = float(np.linalg.norm(moved * [own.noise for own in joints]))
        return Shaken(known.time, parts, weights, known.stretches, noise, begun, begun_sd)

    def _moved(self, joints: np.ndarray) -> np.ndarray:
        """By how much each of the `joints` (joint,), where they are, moves the centre of each body along the axis,
        (body, joint), m per m or rad.
        """
        model, jacobian = self.model, np.zeros((3, self.model.nv))
        data, moved = mujoco.MjData(model), []
        data.qpos[model.jnt_qposadr] = joints
        mujoco.mj_fwdPosition(model, data)
        for body in self.moving:
            mujoco.mj_jacBodyCom(model, data, jacobian, None, int(body))
            moved.append(jacobian[self.axis, model.jnt_dofadr])
        return np.array(moved)

    def weights(self, world):
        masses = world.vary("body_mass")[:, self.moving]
        return masses / masses.sum(axis=1, keepdims=True)

    def share(self, values):
        return values[:, 0]

    def shaking(self, world):
        masses = world.vary("body_mass")
        per_speed = momentum_along(
            self.model, self.axis, world.cdof, world.subtree_com, world.vary("body_subtreemass")
        )
        speed = (per_speed * world.qvel).sum(axis=1) / masses[:, self.moving].sum(axis=1)
        return centre_along(masses, world.xipos, self.moving, self.axis), speed

    def force(self, values, timestep, *, states=None, first=None, late=None, **_):
        agitated = 5.0  # m/s^2: accelerations of the centre of mass, commonly within
        shown = self.shown_at(first, None if late is None else late.mean(axis=1))
        begins = self.begins(values, states, agitated * values[:, 0], timestep=timestep, shown=shown)
        kind = ForceOfBase if self.accelerometers else ForceOfUnseenBase
        return kind(self, self.coefficients(values) | begins, timestep)

    def companion(self, name, values):
        given = ["per_speed @ data.qvel", "per_speed @ data.qacc", "mass", "gives / mass"]
        term, state = call(name, SprungBase, given, self.numbers(values))
        fields = "data.cdof, data.subtree_com, model.body_subtreemass"
        lines = (
            f"per_speed = momentum_along(model, {self.axis}, {fields})",
            f"mass = model.body_mass[{self.moving}].sum()",
            "gives = gives_way(model, data.qLD, data.qLDiagInv, dict(enumerate(per_speed)))",
            f"data.qfrc_applied -= per_speed * {term}",
        )
        after = tuple(
            f"data.sensordata[{at}:{at + 3}] += data.site_xmat[{site}].reshape(3, 3)[{self.axis}]"
            f" * {kept(name)}.accelerates"
            for at, site in self.accelerometers.items()
        )
        return Companion((momentum_along, gives_way, SprungBase), lines, state, ("data.qfrc_applied",), after)


class ForceOfUnseenBase(ForceShakenBefore):
    """What holds the masses back that move on the base while it accelerates, over a batch, chunk after chunk."""

    def __call__(self, world: World) -> None:
        effect, base = self.effect, self.kernel_in(world)
        masses, subtrees = world.vary("body_mass"), world.vary("body_subtreemass")
        per_speed = momentum_along(effect.model, effect.axis, world.cdof, world.subtree_com, subtrees)
        momentum, force = (per_speed * world.qvel).sum(axis=1), (per_speed * world.qacc).sum(axis=1)
        mass = masses[:, effect.moving].sum(axis=1)
        gives = 0.0
        if not world.recorded:
            gives = gives_way(effect.model, world.qLD, world.qLDiagInv, dict(enumerate(per_speed.T)))
        accelerates = base(momentum, force, mass, gives / mass)
        world.qfrc_applied[:] -= per_speed * accelerates[:, None]


class ForceOfBase(ForceOfUnseenBase):
    """That of a base on which there are accelerometers."""

    def __call__(self, world: World) -> None:
        # asked for before the step: afterwards it would be worked out for its end
        self.frames = world.site_xmat
        super().__call__(world)

    def report(self, sensordata: np.ndarray) -> None:
        """Add what the accelerometers show of the base, in frames of their own, to sensordata (simulation, column)."""
        for at, site in self.effect.accelerometers.items():
            axis = self.frames[:, site].reshape(-1, 3, 3)[:, self.effect.axis]
            sensordata[:, at : at + 3] += axis * self.term.accelerates[:, None]


def _accelerometers(model: mujoco.MjModel) -> dict[int, int]:
    """The site that each is at, by the first of its columns of sensordata."""
    own = np.flatnonzero(model.sensor_type == int(mujoco.mjtSensor.mjSENS_ACCELEROMETER))
    return {int(model.sensor_adr[s]): int(model.sensor_objid[s]) for s in own}


@lru_cache(maxsize=16)
def _pushed(model: mujoco.MjModel) -> tuple[int, ...]:
    """Axes of the world along which joints that actuators drive move masses, in one of some poses."""
    dofs = model.jnt_dofadr[driven_joints(model, by_tendons=True)]
    generator = np.random.default_rng(0)
    data, found = mujoco.MjData(model), set()
    seen = 1e-6  # of all mass, per m/s, or per rad/s at 1 m
    poses = 4  # in which it is looked at whether the machine can push its base along an axis
    for _ in range(poses):
        mujoco.mj_integratePos(model, data.qpos, generator.standard_normal(model.nv), 1.0)
        mujoco.mj_fwdPosition(model, data)
        for k in range(len(AXES)):
            moved = momentum_along(model, k, data.cdof, data.subtree_com, model.body_subtreemass)
            if np.abs(moved[dofs]).max(initial=0.0) > seen * model.body_subtreemass[0]:
                found.add(k)
    return tuple(sorted(found))
