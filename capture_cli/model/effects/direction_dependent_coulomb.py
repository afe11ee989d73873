"""Dry friction that differs with the direction of motion."""

import numpy as np

from capture_cli.model.effects._joint_force import FRICTION, JointForce
from capture_cli.model.parameters import Parameter


def coulomb_asymmetry(qvel, *, asymmetry):
    """Dry friction added: asymmetry sign(v)."""
    return asymmetry * np.sign(qvel)


class DirectionDependentCoulomb(JointForce):
    """`asymmetry` is added to the joint's dry friction in forward motion, and subtracted from it in backward
    motion.

    In neither direction does the friction fall below zero: on a joint without friction only one direction has
    any.
    """

    summary = "dry friction that differs between forward and backward motion"
    kernel = staticmethod(coulomb_asymmetry)
    adds_to = FRICTION

    @property
    def parameters(self):
        high = self.characteristic_force
        return (Parameter("asymmetry", self.unit("N", "N m"), -high, high, 0.0),)
