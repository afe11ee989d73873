"""Forces that remember: with what one begins inside a log follows from where the log saw the joint before."""

from abc import abstractmethod

import numpy as np

from capture_cli.model.effects._joint_force import ForceOfKernel, JointForce


class FollowedForce(JointForce):
    """A force whose kernel keeps a state that the log tells, where it measures the joint's position.

    A simulation that begins in no log begins with what the kernel begins with by itself.
    """

    @property
    def shows(self):
        return super().shows and self.seen is not None

    def force(self, values, timestep, *, states=None, first=None, **_):
        given = self.coefficients(values)
        if first is None or self.seen is None:
            return ForceOfKernel(self, given, timestep)
        states = np.zeros((len(values), len(self.states))) if states is None else states
        return self.force_since(given, timestep, first, states)

    @abstractmethod
    def force_since(
        self, given: dict[str, np.ndarray], timestep: float, first: np.ndarray, states: np.ndarray
    ) -> ForceOfKernel:
        """The force of simulations that begin at the steps `first` of the log, (simulation,), with `states`
        (simulation, state); given: the kernel's coefficients, (simulation,) each.
        """
