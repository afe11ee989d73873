"""What tells one compiled model from another."""

import hashlib
from collections.abc import Mapping
from copy import copy
from typing import Any

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


def is_of_another(histories: Mapping[str, Any], model: mujoco.MjModel) -> bool:
    """Whether histories, of which these are the attributes, were of another model; another version of MuJoCo writes
    models otherwise: then it is not known.
    """
    return histories["mujoco"] == mujoco.__version__ and histories["model"] != model_hash(model)
