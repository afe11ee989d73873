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


def is_servo(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether what the actuator is told is a position or a speed that it seeks, not a force or a voltage."""
    gain, (_, stiffness, damping) = model.actuator_gainprm[actuator, 0], model.actuator_biasprm[actuator, :3]
    seeks_speed = damping != 0 and damping == -gain
    return bool(model.actuator_gaintype[actuator] == _PID or stiffness != 0 or seeks_speed)
