"""A rotor and a link that are not one: what compliance and backlash share.

The model's joint carries rotor and link as one rigid inertia M. With J of it in the rotor, which runs ahead
of the link by the deflection d, the rotor obeys J (a + d'') = T - F and the link (M - J) a = F + rest, with
a the joint's acceleration, T the actuators' force and F what the transmission passes on. Together,
M a = T + rest - J d'': the model's own joint with the extra force -J d''. Eliminating a,

    d'' (1 - J / M) = (T - F) / J - b,    b = a + (J / M) d''   (the acceleration without the extra force).

T and b are those of the step before; d is kept per simulation. Actuators and sensors go on seeing the joint,
which is the link: an encoder on the rotor, and a servo that closes its loop there, are outside of this.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from capture_cli.sim.engine import World


class TwoMass(ABC):
    """The force of a rotor of inertia `rotor` (simulation,), kg or kg m^2, on degree of freedom `dof`.

    total: M, kg or kg m^2. The pose and other joints change the true one; then b is known a step late, which
    is stable as long as the rotor has less than half of the inertia.
    """

    def __init__(self, dof: int, total: float, rotor: np.ndarray, timestep: float):
        self.dof, self.timestep = dof, timestep
        self.rotor, self.share = rotor, rotor / total
        self.deflection = np.zeros(len(rotor))
        self.rate = np.zeros(len(rotor))
        self.jolt = np.zeros(len(rotor))  # d'' of the last step
        self.speed = np.full(len(rotor), np.nan)  # of the joint, at the last step

    def __call__(self, world: World) -> None:
        rows, h = world.rows, self.timestep
        speed = world.qvel[:, self.dof]
        first = np.isnan(self.speed[rows])
        acceleration = np.where(first, world.qacc[:, self.dof], (speed - self.speed[rows]) / h)
        rigid = acceleration + self.share[rows] * self.jolt[rows]
        torque = world.qfrc_actuator[:, self.dof]
        passed = torque - self.rotor[rows] * rigid
        self.deflection[rows] = np.where(first, self.at_rest(rows, passed), self.deflection[rows])
        pull = passed / (self.rotor[rows] * (1 - self.share[rows]))
        deflection, rate = self.advance(rows, pull)
        self.jolt[rows] = (rate - self.rate[rows]) / h
        self.deflection[rows], self.rate[rows], self.speed[rows] = deflection, rate, speed
        world.qfrc_applied[:, self.dof] -= self.rotor[rows] * self.jolt[rows]

    @abstractmethod
    def at_rest(self, rows: np.ndarray, passed: np.ndarray) -> np.ndarray:
        """Deflection (row,) at which the transmission passes on the force `passed` (row,) and rests."""

    @abstractmethod
    def advance(self, rows: np.ndarray, pull: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Deflection and its rate (row,) after a step; d'' is `pull` (row,) while nothing is passed on."""
