"""Forces that remember: with what one begins inside a log follows from where the log saw the joint before."""

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from capture_cli.model.effects._followed_log import steps_later
from capture_cli.model.effects._joint_force import ForceOfKernel, JointForce


@dataclass(frozen=True)
class Begins:
    """Where simulations begin inside a log: at its steps `first` (simulation,), with `states` (simulation, state).

    late (simulation,): s, after which the log shows the joint as it is there, at the step `shown`, fractional.
    """

    first: np.ndarray
    late: np.ndarray
    shown: np.ndarray
    states: np.ndarray


class FollowedForce(JointForce):
    """A force whose kernel keeps a state that the log tells, where it measures the joint's position.

    A simulation that begins in no log begins with what the kernel begins with by itself.
    """

    @property
    def shows(self):
        return super().shows and self.seen is not None

    def force(self, values, timestep, *, states=None, first=None, late=None, **_):
        given = self.coefficients(values)
        if first is None or self.seen is None:
            return ForceOfKernel(self, given, timestep)
        states = np.zeros((len(values), len(self.states))) if states is None else states
        late = np.zeros(len(values)) if late is None else late[:, self.dof]
        shown = steps_later(self.seen.time, self.seen.stretches, first, late)
        return self.force_since(given, timestep, Begins(first, late, shown, states))

    @abstractmethod
    def force_since(self, given: dict[str, np.ndarray], timestep: float, begins: Begins) -> ForceOfKernel:
        """The force of simulations that begin inside the log; given: the kernel's coefficients, (simulation,) each."""
