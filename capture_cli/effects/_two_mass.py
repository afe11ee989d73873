"""A rotor and a link that are not one: what compliance and backlash share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import product

import mujoco
import numpy as np

from capture_cli.effects._joint_effect import driven_joints
from capture_cli.effects._joint_force import FRICTION, ForceOfKernel, JointForce
from capture_cli.effects._kernel import INDENT, Companion, kept, number
from capture_cli.effects._places import site_id, site_name
from capture_cli.effects._scales import free_inertia
from capture_cli.effects.base import GLOBAL, spread
from capture_cli.parameters import Parameter

POSITION, SPEED = int(mujoco.mjtSensor.mjSENS_JOINTPOS), int(mujoco.mjtSensor.mjSENS_JOINTVEL)
MOST_SHARE = 0.99  # of the inertia, in the rotor: a link weighs something in any pose


class TransmissionEffect(JointForce):
    """An effect between a motor and the joint that it drives. Its kernel is a TwoMass."""

    where = "every hinge and slide joint that an actuator drives; JOINT+SENSOR where that sensor of it is the motor's"
    shares = ("motor_damping", "motor_friction")
    states = ("ahead", "turning")
    # A rotor that crosses its play is seldom faster than half of what the largest force would give it there.
    states_tried = np.array(list(product(np.linspace(-1, 1, 9), np.linspace(-0.6, 0.6, 25))))

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        _, encoders = _places(model)[site]
        self.on_motor = MotorEncoders(model, self.joint, encoders) if encoders else None

    @classmethod
    def sites(cls, model):
        return list(_places(model))

    @classmethod
    def joint_at(cls, model, site):
        return _places(model)[site][0]

    @property
    def reported(self):
        return self.on_motor.reported if self.on_motor else frozenset()

    @property
    def total(self) -> float:
        """kg or kg m^2: inertia of rotor and link."""
        return free_inertia(self.model, self.joint)

    @property
    def rotor(self) -> Parameter:
        """The part of the inertia on the motor's side."""
        mass = self.total
        return Parameter("rotor", self.unit("kg", "kg m^2"), 0.05 * mass, MOST_SHARE * mass, 0.2 * mass)

    @property
    def motor_damping(self) -> Parameter:
        """The share of the joint's damping on the motor's side: of a geared joint, most of it."""
        return Parameter("motor_damping", "1", 0.0, 1.0, 0.5)

    @property
    def motor_friction(self) -> tuple[Parameter, ...]:
        """The share of the joint's dry friction on the motor's side, where it has any."""
        if not self.model.dof_frictionloss[self.dof]:
            return ()
        return (Parameter("motor_friction", "1", 0.0, 1.0, 0.0),)

    def coefficients(self, values):
        given = super().coefficients(values)
        if "motor_friction" in given:  # without play or give the motor's friction is the joint's
            given["motor_friction"] = np.where(values[:, 0] > 0, given["motor_friction"], 0.0)
        return given

    def shape_grid(self, count=5):
        # while a transmission is nearly rigid, little else of its shape shows than its rotor
        grid = np.repeat(self.space.nominal[None], count, axis=0)
        grid[:, self.space.names.index("rotor")] = spread(self.rotor, count)
        return grid

    def force(self, values, timestep, *, states=None, **_):
        states = np.zeros((len(values), len(self.states))) if states is None else states
        room, speed = self.looseness(values)
        start = {"ahead": room * states[:, 0], "turning": speed * states[:, 1]}
        kind = TransmissionForce if self.on_motor is None else TransmissionSeenFromMotor
        return kind(self, self.coefficients(values) | start, timestep)

    def companion(self, name, values):
        own = super().companion(name, values)
        share = self.coefficients(values[None]).get("motor_friction", np.zeros(1))[0]
        if share:
            field = f"model.{FRICTION}"
            lines = (*own.lines, f"{field}[dof] *= 1 - {number(share)}")
            own = replace(own, lines=lines, changes=(*own.changes, field))
        return own if self.on_motor is None else self.on_motor.in_companion(own, kept(name))

    @abstractmethod
    def looseness(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far and how fast the rotor may run ahead of the link, (simulation,) each."""


class TransmissionForce(ForceOfKernel):
    """The force of a TwoMass, which takes the motor's share of the joint's dry friction off it."""

    def __call__(self, world):
        super().__call__(world)
        share = self.coefficients.get("motor_friction")
        if share is not None:
            world.vary(FRICTION)[:, self.effect.dof] *= 1 - share[world.rows]


class TransmissionSeenFromMotor(TransmissionForce):
    """That of a joint of which encoders show the rotor: a simulation begins where they say, less the deflection."""

    def __call__(self, world):
        begins = world is not self.world
        super().__call__(world)
        if begins:
            self.effect.on_motor.begin(world.qpos, world.qvel, self.term.seen)

    def report(self, sensordata: np.ndarray) -> None:
        """Add to what the sensors of the joint show, (simulation, nsensordata), how far ahead the rotor was."""
        self.effect.on_motor.show(sensordata, self.term.seen)


class MotorEncoders:
    """The sensors among those of a joint that see the rotor, which is ahead of the joint by d at d'."""

    def __init__(self, model: mujoco.MjModel, joint: int, sensors: Sequence[int]):
        kinds = {int(s): int(model.sensor_type[s]) for s in sensors}
        others = {int(model.sensor_type[s]) for s in _encoders(model, joint) if s not in kinds}
        self.positions = [int(model.sensor_adr[s]) for s, kind in kinds.items() if kind == POSITION]
        self.speeds = [int(model.sensor_adr[s]) for s, kind in kinds.items() if kind == SPEED]
        self.at, self.dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        # without one of its own the speed is that of the position
        self.begins_with_speed = bool(self.speeds or (self.positions and SPEED not in others))

    @property
    def reported(self) -> frozenset[int]:
        """Columns of sensordata."""
        return frozenset([*self.positions, *self.speeds])

    def begin(self, qpos: np.ndarray, qvel: np.ndarray, seen: tuple[np.ndarray, np.ndarray]) -> None:
        """Put the joint where the rotor was said to be, less (d, d')."""
        if self.positions:
            qpos[:, self.at] -= seen[0]
        if self.begins_with_speed:
            qvel[:, self.dof] -= seen[1]

    def show(self, sensordata: np.ndarray, seen: tuple[np.ndarray, np.ndarray]) -> None:
        """Add (d, d') to sensordata (simulation, column)."""
        for columns, ahead in zip((self.positions, self.speeds), seen, strict=True):
            sensordata[:, columns] += ahead[:, None]

    def in_companion(self, own: Companion, drive: str) -> Companion:
        """The companion of the transmission, `drive` its kernel, with the encoders."""
        begin = [f"data.qpos[{[self.at]}] -= {drive}.seen[0]"] * bool(self.positions)
        begin += [f"data.qvel[{[self.dof]}] -= {drive}.seen[1]"] * self.begins_with_speed
        lines = (
            f"begins = {drive}.speed is None",
            *own.lines,
            "if begins:  # the encoder showed where the rotor was",
            *(INDENT + line for line in begin),
        )
        after = [f"data.sensordata[{self.positions}] += {drive}.seen[0]"] * bool(self.positions)
        after += [f"data.sensordata[{self.speeds}] += {drive}.seen[1]"] * bool(self.speeds)
        return replace(own, lines=lines, after=tuple(after))


@lru_cache(maxsize=16)
def _places(model: mujoco.MjModel) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Sites: a joint that an actuator drives, and which of its encoders are the motor's."""
    places = {}
    for joint in driven_joints(model):
        encoders = _encoders(model, site_id(model, "joint", joint))
        some = [(e,) for e in encoders] + ([tuple(encoders)] if len(encoders) > 1 else [])
        for sensors in [(), *some]:
            places["+".join([joint, *(site_name(model, "sensor", s) for s in sensors)])] = (joint, sensors)
    return places


def _encoders(model: mujoco.MjModel, joint: int) -> list[int]:
    own = (model.sensor_objid == joint) & np.isin(model.sensor_type, (POSITION, SPEED))
    return [int(s) for s in np.flatnonzero(own)]


class TwoMass(ABC):
    """The force -J d'' on a joint whose rotor of inertia J (kg or kg m^2) is not rigidly its link's.

    The model's joint carries rotor and link as one rigid inertia M. With J of it in the rotor, which
    runs ahead of the link by the deflection d, the rotor obeys J (a + d'') = T - F and the link
    (M - J) a = F + rest, with a the joint's acceleration, T the actuators' force and F what the transmission
    passes on. Together, M a = T + rest - J d'': the model's own joint with the extra force -J d''.
    Eliminating a,

        d'' (1 - J / M) = (T - F) / J - b,   b = a + (J / M) d''   (the acceleration without the extra force).

    Of the joint's damping a part B may be the motor's. It then slows the rotor by B (v + d'), with v the joint's speed,
    and the link no more by B v: T is less by B v, the extra force is -J d'' - B d', and d'' is less by B d' / J.
    Of its dry friction a part may be the motor's, too: a force f against the rotor's speed v + d', as large as that
    part or as large as stops the rotor within the step. T is less by f, and so is the extra force.

    T and b are those of the step before. Actuators go on seeing the joint, which is the link: a servo that closes its
    loop on the rotor is outside of this. M is what a force on the joint alone has to accelerate, in the pose of the
    step before. seen: d and d' at the beginning of the last step, which an encoder on the rotor shows.
    """

    def __init__(self, *, rotor, timestep, motor_damping=0.0, motor_friction=0.0, ahead=0.0, turning=0.0):
        self.rotor, self.timestep = rotor, timestep
        self.motor_damping = motor_damping  # B over the joint's damping
        self.motor_friction = motor_friction  # over the joint's dry friction
        self.ahead = ahead  # of where it would rest, at the start
        self.deflection = self.extra = 0.0 * rotor  # d, and the force of the last step
        self.rate, self.acceleration = turning + 0.0 * rotor, 0.0 * rotor  # d', d''
        self.speed = None  # of the joint, at the last step

    def __call__(self, qvel, qacc, qfrc_actuator, dof_damping, dof_frictionloss, inertia):
        """The force -J d'' - B d' - f. qacc, qfrc_actuator and inertia (M) are of the step before."""
        h, first = self.timestep, self.speed is None
        damping = self.motor_damping * dof_damping
        rotor = np.minimum(self.rotor, MOST_SHARE * inertia)
        apart = 1 - rotor / inertia
        friction = self.motor_friction * dof_frictionloss
        rigid = (qacc if first else (qvel - self.speed) / h) - self.extra / inertia
        if first:  # the step before knew nothing of the motor's part
            rigid = rigid + friction * np.sign(qvel) / inertia
        passed = qfrc_actuator - damping * qvel - rotor * rigid
        if first:
            self.deflection = self.limited(self.at_rest(passed) + self.ahead)
        self.seen = self.deflection, self.rate

        def resisted(friction):
            """The state of the transmission, the extra force, and the rotor's speed after a step."""
            state = self.advance(passed - friction * apart, rotor * apart, damping / rotor)
            extra = -rotor * ((state[1] - self.rate) / h) - damping * state[1] - friction
            return state, extra, qvel + h * (rigid + extra / inertia) + state[1]

        state, extra, turning = resisted(0.0)
        if np.any(friction):
            friction = friction * np.sign(turning)
            change = resisted(friction)[2] - turning
            stops = np.clip(np.divide(-turning, change, out=np.ones_like(change), where=change != 0), 0, 1)
            state, extra, _ = resisted(friction * stops)
        self.deflection, self.rate, self.acceleration = state
        self.extra, self.speed = extra, np.array(qvel)
        return extra

    @abstractmethod
    def at_rest(self, passed):
        """Deflection at which the transmission passes on the force `passed` and rests."""

    def limited(self, deflection):
        """The deflection, where the transmission sets limits to it."""
        return deflection

    @abstractmethod
    def advance(self, passed, against, slowing):
        """d, d' and d'' after a step. While nothing is passed on, d'' is `passed` / `against` - `slowing` d'.

        against: inertia, of the rotor against the link. slowing: 1/s.
        """
