"""Viscous friction that differs with the direction of motion, as on a worn screw."""

import numpy as np

from capture_cli.model.effects._joint_force import DAMPING, JointForce
from capture_cli.model.parameters import Parameter


def viscous_asymmetry(qvel, *, asymmetry):
    """Damping added: asymmetry sign(v)."""
    return asymmetry * np.sign(qvel)


class DirectionDependentViscous(JointForce):
    """`asymmetry` is added to the joint's damping in forward motion, and subtracted from it in backward
    motion.

    In neither direction does the damping fall below zero: on a joint without damping only one direction has
    any. It changes MuJoCo's own damping step by step, which is integrated as that is.
    """

    summary = "viscous friction that differs between forward and backward motion"
    kernel = staticmethod(viscous_asymmetry)
    adds_to = DAMPING

    @property
    def parameters(self):
        high = 2 * self.characteristic_force / self.characteristic_speed
        return (Parameter("asymmetry", self.unit("N s/m", "N m s/rad"), -high, high, 0.0),)
