"""Actuators whose force is linear in the parameters of their gain and bias: neither muscles nor dcmotors."""

from __future__ import annotations

import mujoco
import numpy as np

GAIN, BIAS, LIMITS = "actuator_gainprm", "actuator_biasprm", "actuator_forcerange"
SCALED = (
    GAIN,
    BIAS,
    LIMITS,
)  # fields of MjModel, (actuator, ...), with all of which the force of an actuator scales
_PID = int(mujoco.mjtGain.mjGAIN_PID)
_GAINS = [int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE), _PID]
_BIASES = [int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)]


def linear_actuators(model: mujoco.MjModel) -> list[int]:
    """Their ids."""
    linear = np.isin(model.actuator_gaintype, _GAINS) & np.isin(model.actuator_biastype, _BIASES)
    return [int(a) for a in np.flatnonzero(linear)]
