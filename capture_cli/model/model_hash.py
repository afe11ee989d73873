"""What tells one compiled model from another."""

from __future__ import annotations

import hashlib

import mujoco
import numpy as np


def model_hash(model: mujoco.MjModel) -> str:
    """sha256 of the compiled model, as this version of MuJoCo writes it."""
    binary = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, buffer=binary)
    return hashlib.sha256(binary.tobytes()).hexdigest()
