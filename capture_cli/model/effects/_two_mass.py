"""A rotor and a link that are not one: the physics that compliance and backlash share."""

from abc import ABC, abstractmethod

import numpy as np

MOST_SHARE = 0.99  # of the inertia, in the rotor: a link weighs something in any pose


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

    The model's actuators see the joint, which is the link. A servo that closes its loop on the rotor gives
    K d + L d' less, with K and L its gains: T is less by that, and so is the extra force.

    T and b are those of the step before. M is what a force on the joint alone has to accelerate, in the pose of the
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

    def __call__(self, qvel, qacc, qfrc_actuator, losses, inertia, servo):
        """The extra force. qacc, qfrc_actuator and inertia (M) are of the step before.

        losses: damping and dry friction of the joint. servo: K and L; 0 where it sees the link.
        """
        rotor = np.minimum(self.rotor, MOST_SHARE * inertia)
        damping, friction = self.motor_damping * losses[0], self.motor_friction * losses[1]
        begins = self.speed is None
        if begins:  # the step before knew nothing of the motor's part of the friction
            rigid = qacc + friction * np.sign(qvel) / inertia
        else:
            rigid = (qvel - self.speed) / self.timestep - self.extra / inertia
        passed = qfrc_actuator - damping * qvel - rotor * rigid
        if begins:
            self.begin(passed)
            # where the joint was until now the rotor is, on which the servo closes its loop
            nearer = servo[0] * self.deflection
            rigid, passed = rigid + nearer / inertia, passed + nearer * (1 - rotor / inertia)
        self.seen = self.deflection, self.rate
        self.step(qvel, rigid, passed, (rotor, inertia), (servo[0], damping + servo[1], friction))
        self.speed = np.array(qvel)
        return self.extra

    def begin(self, passed):
        """Wind the transmission up, as it is at the start under the force `passed`."""
        self.deflection = self.at_rest(passed) + self.ahead

    def step(self, qvel, rigid, passed, inertias, resists):
        """Advance the transmission by a step, on which `passed` - f acts, and with it the extra force.

        inertias: of the rotor, and M. resists: what holds the rotor: stiffness, damping and dry friction.
        """
        (rotor, inertia), (holding, damping, friction) = inertias, resists
        h, apart = self.timestep, 1 - rotor / inertia

        def resisted(friction):
            """The state of the transmission, the extra force, and the rotor's speed after a step."""
            state = self.advance(passed - friction * apart, rotor * apart, damping / rotor, holding * apart)
            extra = -rotor * ((state[1] - self.rate) / h) - damping * state[1] - holding * state[0] - friction
            return state, extra, qvel + h * (rigid + extra / inertia) + state[1]

        state, extra, turning = resisted(0.0)
        if np.any(friction):
            friction = friction * np.sign(turning)
            change = resisted(friction)[2] - turning
            stops = np.clip(np.divide(-turning, change, out=np.ones_like(change), where=change != 0), 0, 1)
            state, extra, _ = resisted(friction * stops)
        (self.deflection, self.rate, self.acceleration), self.extra = state, extra

    @abstractmethod
    def at_rest(self, passed):
        """Deflection at which the transmission passes on the force `passed` and rests."""

    @abstractmethod
    def advance(self, passed, against, slowing, holding):
        """d, d' and d'' after a step. Where nothing is passed on, d'' = (passed - holding d) / against - slowing d'.

        against: inertia, of the rotor against the link. slowing: 1/s. holding: stiffness, likewise.
        """
