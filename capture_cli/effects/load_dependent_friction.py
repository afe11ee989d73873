"""Dry friction that grows with the torque a gear transmits."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._joint_effect import JointEffect, driven_joints
from capture_cli.parameters import Parameter
from capture_cli.sim.engine import World


class LoadDependentFriction(JointEffect):
    """`coefficient` x |motor torque - load torque| is added to the joint's dry friction.

    The two torques squeeze the gear between them: a motor that holds a load up counts twice the load. The
    load is gravity with Coriolis forces, springs and the medium; forces of contacts are not in it. At 1 the
    gear is self-locking. The term is that of Duclusaud et al., "Extended friction models for the physics
    simulation of servo actuators" (arXiv 2410.08650), without their constant part, which is coulomb-friction.
    """

    place = "force"
    summary = "dry friction that grows with the torque that a gear transmits"
    where = "every hinge and slide joint that an actuator drives"

    @classmethod
    def sites(cls, model):
        return driven_joints(model)

    @property
    def parameters(self):
        return (Parameter("coefficient", "1", 0.0, 1.0, 0.0),)

    def force(self, values, timestep):
        dof = self.dof

        def with_load(world: World) -> None:
            load = world.qfrc_spring[:, dof] + world.qfrc_gravcomp[:, dof] + world.qfrc_fluid[:, dof]
            load = load - world.qfrc_bias[:, dof]
            squeeze = np.abs(world.qfrc_actuator[:, dof] - load)
            world.vary("dof_frictionloss")[:, dof] += values[world.rows, 0] * squeeze

        return with_load
