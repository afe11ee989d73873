"""A rotor and a link that are not one: what compliance and backlash share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from itertools import product

import numpy as np

from capture_cli.effects._joint_effect import driven_joints
from capture_cli.effects._joint_force import FRICTION, ForceOfKernel, JointForce
from capture_cli.effects._kernel import Companion, number
from capture_cli.effects._scales import free_inertia
from capture_cli.effects.base import spread
from capture_cli.parameters import Parameter

MOST_SHARE = 0.99  # of the inertia, in the rotor: a link weighs something in any pose


class TransmissionEffect(JointForce):
    """An effect between a motor and the joint that it drives. Its kernel is a TwoMass."""

    where = "every hinge and slide joint that an actuator drives"
    shares = ("motor_damping", "motor_friction")
    states = ("ahead", "turning")
    # A rotor that crosses its play is seldom faster than half of what the largest force would give it there.
    states_tried = np.array(list(product(np.linspace(-1, 1, 9), np.linspace(-0.6, 0.6, 25))))

    @classmethod
    def sites(cls, model):
        return driven_joints(model)

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
        return TransmissionForce(self, self.coefficients(values) | start, timestep)

    def companion(self, name, values):
        own = super().companion(name, values)
        share = self.coefficients(values[None]).get("motor_friction", np.zeros(1))[0]
        if not share:
            return own
        field = f"model.{FRICTION}"
        lines = (*own.lines, f"{field}[dof] *= 1 - {number(share)}")
        return Companion(own.kernels, lines, own.state, (*own.changes, field))

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

    T and b are those of the step before. Actuators and sensors go on seeing the joint, which is the link: an
    encoder on the rotor, and a servo that closes its loop there, are outside of this. M is what a force on the joint
    alone has to accelerate, in the pose of the step before.
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
