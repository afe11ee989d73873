"""Dry friction that grows with the torque a gear transmits."""

import numpy as np

from capture_cli.model.effects._joint_force import FRICTION, JointForce
from capture_cli.model.effects._scales import driven_joints
from capture_cli.model.object_names import object_name
from capture_cli.model.parameters import Parameter


def load_friction(qfrc_actuator, load_torque, *, coefficient, load):
    """Dry friction added: coefficient |motor torque - load * load torque|."""
    return coefficient * np.abs(qfrc_actuator - load * load_torque)


class LoadDependentFriction(JointForce):
    """`coefficient` x |motor torque - `load` x load torque| is added to the joint's dry friction.

    With a `load` of 1 the two torques squeeze a gear between them: a motor that holds a load up counts twice the load.
    That is the term of Duclusaud et al., "Extended friction models for the physics simulation of servo actuators"
    (arXiv 2410.08650), without their constant part, which is coulomb-friction. With 0 it is the loss of a gear or a
    cable of constant efficiency. The load torque is gravity with Coriolis forces, springs and the medium; forces of
    contacts are not in it.
    """

    summary = "dry friction that grows with the torque that a gear or a cable transmits"
    where = "every hinge and slide joint that an actuator drives, itself or by a tendon"
    shapes = shares = ("load",)
    kernel = staticmethod(load_friction)
    adds_to = FRICTION
    parameters = (Parameter("coefficient", "1", 0.0, 1.0, 0.0), Parameter("load", "1", 0.0, 1.0, 1.0))

    @classmethod
    def sites(cls, model):
        return [object_name(model, "joint", j) for j in driven_joints(model, by_tendons=True)]
