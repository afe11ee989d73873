"""robosuite 1.5.2 on MuJoCo 4: what has changed in MuJoCo since, put right in robosuite.

robosuite 1.5.2 works unpatched up to MuJoCo 3.9. Since then `mj_fullM` takes MjData rather than its matrix, which is
gone, and a number from an array is no longer found in an enumeration. Its joint-velocity controller never worked: it
assigns what its base class computes. Importing this module patches it.
"""

import importlib.metadata
import logging

import mujoco
import numpy as np

from capture_cli.common.extras import require
from capture_cli.errors import OptionError

PATCHED_VERSION = "1.5.2"
_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)


def patch_robosuite() -> None:
    """Make robosuite usable. Raises OptionError where it is missing or of another version."""
    require("robosuite", "a robosuite scene")
    found = importlib.metadata.version("robosuite")
    if found != PATCHED_VERSION:
        raise OptionError(
            f"robosuite {found} is installed; its patches for MuJoCo 4 are for {PATCHED_VERSION}",
            cure=f"pip install robosuite=={PATCHED_VERSION}",
        )
    # it warns of optional packages at every import
    logging.getLogger("robosuite_logs").addFilter(lambda record: record.levelno >= logging.ERROR)
    from robosuite.controllers.parts.controller import Controller
    from robosuite.controllers.parts.generic.joint_vel import JointVelocityController
    from robosuite.utils.binding_utils import MjModel

    MjModel.get_joint_qpos_addr = _address("jnt_qposadr", free=7, ball=4)
    MjModel.get_joint_qvel_addr = _address("jnt_dofadr", free=6, ball=3)
    Controller.update = _update
    JointVelocityController.torque_compensation = property(_compensation, _compensate)


def _address(field: str, *, free: int, ball: int):
    """A method of MjModel: the address of a joint's coordinates, or (first, last + 1) where it has several."""

    def address(self, name: str):
        joint = self.joint_name2id(name)
        first = getattr(self, field)[joint]
        count = {_FREE: free, _BALL: ball}.get(int(self.jnt_type[joint]), 1)
        return first if count == 1 else (first, first + count)

    return address


def _update(self, force: bool = False) -> None:
    """`Controller.update`: state, Jacobians and mass matrix of its joints, unless they are up to date."""
    if not (self.new_update or force):
        return
    if force or not self.lite_physics:
        self.sim.forward()
    if self.ref_name is not None:
        self.update_reference_data()
    self.joint_pos = np.array(self.sim.data.qpos[self.qpos_index])
    self.joint_vel = np.array(self.sim.data.qvel[self.qvel_index])
    model = self.sim.model._model
    mass_matrix = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, self.sim.data._data, mass_matrix)
    self.mass_matrix = mass_matrix[np.ix_(self.qvel_index, self.qvel_index)]
    self.new_update = False


class _Compensation:
    """Torques (joint,) against gravity that are true: `run_controller` asks whether there are any, and adds them."""

    __array_ufunc__ = None  # an array leaves the sum to __radd__

    def __init__(self, torques: np.ndarray):
        self.torques = torques

    def __bool__(self) -> bool:
        return True

    def __radd__(self, other: np.ndarray) -> np.ndarray:
        return other + self.torques


def _compensation(self) -> _Compensation | None:
    return _Compensation(self.sim.data.qfrc_bias[self.qvel_index]) if self._compensates else None


def _compensate(self, wanted: bool) -> None:
    self._compensates = wanted


patch_robosuite()
