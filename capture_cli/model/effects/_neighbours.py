"""Joints that follow each other along a chain of bodies."""

import mujoco

from capture_cli.model.effects._scales import HINGE, SLIDE


def joint_before(model: mujoco.MjModel, joint: int) -> int:
    """The hinge or slide joint that this one hangs on, or -1."""
    dof = model.dof_parentid[model.jnt_dofadr[joint]]
    if dof < 0 or model.jnt_type[model.dof_jntid[dof]] not in (HINGE, SLIDE):
        return -1
    return int(model.dof_jntid[dof])
