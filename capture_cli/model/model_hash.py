"""What tells one compiled model from another."""

from __future__ import annotations

import hashlib
from copy import copy

import mujoco
import numpy as np

# how contacts are searched, which are the same with and without
SEARCHED = int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)


def model_hash(model: mujoco.MjModel) -> str:
    """sha256 of the compiled model, as this version of MuJoCo writes it, whatever way contacts are searched."""
    model = copy(model)
    model.opt.disableflags &= ~SEARCHED
    binary = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, buffer=binary)
    return hashlib.sha256(binary.tobytes()).hexdigest()
