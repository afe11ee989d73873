"""Actuators whose force is linear in the parameters of their gain and bias: neither muscles nor dcmotors."""

from __future__ import annotations

import mujoco
import numpy as np

# Fields of MjModel, (actuator, ...), with all of which together the force of such an actuator scales
SCALED = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")
_G = mujoco.mjtGain
_GAINS = [int(_G.mjGAIN_FIXED), int(_G.mjGAIN_AFFINE), int(_G.mjGAIN_PID)]
_BIASES = [int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)]


def linear_actuators(model: mujoco.MjModel) -> list[int]:
    """Their ids."""
    linear = np.isin(model.actuator_gaintype, _GAINS) & np.isin(model.actuator_biastype, _BIASES)
    return [int(a) for a in np.flatnonzero(linear)]
