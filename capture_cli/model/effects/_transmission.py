"""Between a motor and the joint that it drives: sites, parameters, and encoders that are the motor's."""

from abc import abstractmethod
from collections.abc import Iterator, Sequence, Set
from dataclasses import replace
from functools import lru_cache
from itertools import product

import mujoco
import numpy as np

from capture_cli.model.effects._joint_force import DAMPING, FRICTION, ForceOfKernel, JointForce
from capture_cli.model.effects._kernel import INDENT, Companion, kept, number
from capture_cli.model.effects._scales import driven_joint, driven_joints, free_inertia
from capture_cli.model.effects._two_mass import MOST_SHARE
from capture_cli.model.effects.base import GLOBAL, spread
from capture_cli.model.object_names import object_name
from capture_cli.model.parameters import Parameter
from capture_cli.model.world import World

_S = mujoco.mjtSensor
GEAR = "actuator_gear"
UNLIMITED = np.array([-np.inf, np.inf])
BIAS, LIMITS = "actuator_biasprm", "actuator_forcerange"
# Inputs of the kernels: the joint's damping and dry friction; gains of servos on the rotor
LOSSES, SERVO = "losses", "servo"
JOINTS_OWN = -1  # of sensors: it is the joint's
POSITIONS = (int(_S.mjSENS_JOINTPOS), int(_S.mjSENS_ACTUATORPOS))
SPEEDS = (int(_S.mjSENS_JOINTVEL), int(_S.mjSENS_ACTUATORVEL))


class TransmissionEffect(JointForce):
    """An effect between a motor and the joint that it drives. Its kernel is a TwoMass."""

    reads_acceleration = True
    where = (
        "every hinge and slide joint that an actuator drives; "
        "JOINT+SENSOR where that sensor, of it or of its actuator, is the motor's"
    )
    shares = ("motor_damping", "motor_friction")
    kernel_keeps = ("deflection", "rate", "extra", "speed")
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
    def variant_of(self):
        return self.joint_name

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

    def read(self, world, field):
        if field == LOSSES:
            return super().read(world, DAMPING), super().read(world, FRICTION)
        if field == SERVO:
            return tuple(sum(self.on_motor.gains(world, k)) if self.on_motor else 0.0 for k in range(2))
        return super().read(world, field)

    def source_of(self, field):
        if field == LOSSES:
            return f"({super().source_of(DAMPING)}, {super().source_of(FRICTION)})"
        if field == SERVO:
            gains = (" + ".join(self.on_motor.gains_source(k)) if self.on_motor else "" for k in range(2))
            return f"({', '.join(gain or '0.0' for gain in gains)})"
        return super().source_of(field)

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


def gain_on_rotor(gear, bias, force, limits):
    """Of a servo's feedback at the joint: by how much its force falls per unit; not at all at a limit of its force."""
    return -(gear**2) * bias * ((limits[..., 0] < force) & (force < limits[..., 1]))


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
        begins = self.begins_in(world)
        term, encoders = self.kernel_in(world), self.effect.on_motor
        # before the kernel sees the speed: it takes the change of it for an acceleration
        if begins and encoders.tell_speed(self.effect.logged):
            encoders.begin_with_speed(world.qvel, term.rate)
        super().__call__(world)
        if begins:
            encoders.begin_at_position(world.qpos, term.seen[0])

    def report(self, sensordata: np.ndarray) -> None:
        """Add to what the sensors of the joint show, (simulation, nsensordata), how far ahead the rotor was."""
        self.effect.on_motor.show(sensordata, self.term.seen, self.world)


class MotorEncoders:
    """The sensors of a joint and of its actuators that see the rotor, which is ahead of the joint by d at d'.

    Servos on the joint close their loops on what they see.

    positions, speeds: their columns of sensordata, and the actuator whose gear times d or d' each shows, {column:
    actuator}; JOINTS_OWN where it shows just that. servos: actuators, and whether the force of each is limited.
    """

    def __init__(self, model: mujoco.MjModel, joint: int, sensors: Sequence[int]):
        def shown(kinds: Sequence[int], numbers: Sequence[int]) -> dict[int, int]:
            own = [s for s in numbers if model.sensor_type[s] in kinds]
            return {int(model.sensor_adr[s]): _actuator(model, s) for s in own}

        self.positions, self.speeds = shown(POSITIONS, sensors), shown(SPEEDS, sensors)
        self.other_speeds = set(shown(SPEEDS, _encoders(model, joint))) - set(self.speeds)
        self.at, self.dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        affine = model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)
        own = [a for a in np.flatnonzero(affine).tolist() if driven_joint(model, a) == joint]
        self.servos = [(a, bool(model.actuator_forcelimited[a])) for a in own]

    @property
    def reported(self) -> frozenset[int]:
        """Columns of sensordata."""
        return frozenset([*self.positions, *self.speeds])

    def tell_speed(self, logged: Set[int] | None) -> bool:
        """Whether a start that was read off the columns `logged`, all where None, has the speed of the rotor."""
        other = self.other_speeds if logged is None else self.other_speeds & logged
        # without one of its own it is the position's
        return bool(self.speeds or (self.positions and not other))

    def on_rotor(self, order: int) -> list[tuple[int, bool]]:
        """Those of the servos whose feedback, 0 of position or 1 of speed, is of the rotor."""
        seen = self.tell_speed(None) if order else bool(self.positions)
        return self.servos if seen else []

    def gains(self, world: World, order: int) -> Iterator[np.ndarray]:
        """Gains at the joint of the servos on the rotor, (simulation,) each."""
        for a, limited in self.on_rotor(order):
            gear, bias = world.vary(GEAR)[:, a, 0], world.vary(BIAS)[:, a, 1 + order]
            limits = world.vary(LIMITS)[:, a] if limited else UNLIMITED
            yield gain_on_rotor(gear, bias, world.actuator_force[:, a], limits)

    def gains_source(self, order: int) -> Iterator[str]:
        """The same in a companion."""
        for a, limited in self.on_rotor(order):
            limits = f"model.{LIMITS}[{a}]" if limited else number(UNLIMITED)
            values = f"model.{GEAR}[{a}, 0], model.{BIAS}[{a}, {1 + order}], data.actuator_force[{a}]"
            yield f"gain_on_rotor({values}, {limits})"

    def begin_with_speed(self, qvel: np.ndarray, rate: np.ndarray) -> None:
        """Take d' off the speed (simulation, dof) of the joint."""
        qvel[:, self.dof] -= rate

    def begin_at_position(self, qpos: np.ndarray, deflection: np.ndarray) -> None:
        """Put the joint where the rotor was said to be, less d."""
        if self.positions:
            qpos[:, self.at] -= deflection

    def show(self, sensordata: np.ndarray, seen: tuple[np.ndarray, np.ndarray], world: World) -> None:
        """Add (d, d') to sensordata (simulation, column), by gears that a parameter may have changed."""
        for actuators, ahead in zip((self.positions, self.speeds), seen, strict=True):
            for column, actuator in actuators.items():
                gear = 1.0 if actuator == JOINTS_OWN else world.vary(GEAR)[:, actuator, 0]
                sensordata[:, column] += gear * ahead

    def in_companion(self, own: Companion, drive: str) -> Companion:
        """The companion of the transmission, `drive` its kernel, with the encoders."""
        begins = (f"begins = {drive}.speed is None",) * bool(self.positions)
        where = (  # the rotor begins to turn with the link
            "if begins:  # the encoder showed where the rotor was",
            f"{INDENT}data.qpos[{[self.at]}] -= {drive}.seen[0]",
        ) * bool(self.positions)
        after = (
            f"data.sensordata[{[column]}] += {drive}.seen[{k}]"
            + f" * model.{GEAR}[{actuator}, 0]" * (actuator != JOINTS_OWN)
            for k, actuators in enumerate((self.positions, self.speeds))
            for column, actuator in actuators.items()
        )
        kernels = (*own.kernels, *([gain_on_rotor] if self.servos else []))
        return replace(own, kernels=kernels, lines=(*begins, *own.lines, *where), after=tuple(after))


@lru_cache(maxsize=16)
def _places(model: mujoco.MjModel) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Sites: a joint that an actuator drives, and which of its encoders are the motor's."""
    places = {}
    for j in driven_joints(model):
        joint, encoders = object_name(model, "joint", j), _encoders(model, j)
        some = [(e,) for e in encoders] + ([tuple(encoders)] if len(encoders) > 1 else [])
        for sensors in [(), *some]:
            places["+".join([joint, *(object_name(model, "sensor", s) for s in sensors)])] = (joint, sensors)
    return places


def _encoders(model: mujoco.MjModel, joint: int) -> list[int]:
    """The sensors that show where a joint is, or how fast it turns: its own, and those of actuators on it."""
    return [
        s
        for s in range(model.nsensor)
        if model.sensor_type[s] in (*POSITIONS, *SPEEDS) and _joint(model, s) == joint
    ]


def _joint(model: mujoco.MjModel, sensor: int) -> int:
    """Of a sensor of a joint or of an actuator; -1 of an actuator that moves something else."""
    which = int(model.sensor_objid[sensor])
    if model.sensor_objtype[sensor] == mujoco.mjtObj.mjOBJ_JOINT:
        return which
    return driven_joint(model, which)


def _actuator(model: mujoco.MjModel, sensor: int) -> int:
    """By whose gear what a sensor shows is more than the joint's position, or speed; JOINTS_OWN by none."""
    is_own = model.sensor_objtype[sensor] == mujoco.mjtObj.mjOBJ_JOINT
    return JOINTS_OWN if is_own else int(model.sensor_objid[sensor])
