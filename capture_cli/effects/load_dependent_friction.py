"""Dry friction that grows with the torque a gear transmits."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._joint_effect import driven_joints
from capture_cli.effects._joint_force import FRICTION, JointForce
from capture_cli.parameters import Parameter


def load_friction(qfrc_actuator, qfrc_spring, qfrc_gravcomp, qfrc_fluid, qfrc_bias, *, coefficient):
    """Dry friction added: coefficient |motor torque - load torque|."""
    load = qfrc_spring + qfrc_gravcomp + qfrc_fluid - qfrc_bias
    return coefficient * np.abs(qfrc_actuator - load)


class LoadDependentFriction(JointForce):
    """`coefficient` x |motor torque - load torque| is added to the joint's dry friction.

    The two torques squeeze the gear between them: a motor that holds a load up counts twice the load. The
    load is gravity with Coriolis forces, springs and the medium; forces of contacts are not in it. At 1 the
    gear is self-locking. The term is that of Duclusaud et al., "Extended friction models for the physics
    simulation of servo actuators" (arXiv 2410.08650), without their constant part, which is coulomb-friction.
    """

    summary = "dry friction that grows with the torque that a gear transmits"
    where = "every hinge and slide joint that an actuator drives"
    kernel = staticmethod(load_friction)
    adds_to = FRICTION

    @classmethod
    def sites(cls, model):
        return driven_joints(model)

    @property
    def parameters(self):
        return (Parameter("coefficient", "1", 0.0, 1.0, 0.0),)
