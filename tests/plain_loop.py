"""An exported model in a plain loop, with the module of its effects beside it, as a user runs it."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable
from pathlib import Path

import mujoco
import numpy as np


def imported(path: Path):
    """The module in a file."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def looped(model: mujoco.MjModel, data: mujoco.MjData, beside, tape: Iterable[np.ndarray]) -> np.ndarray:
    """Sensordata (step, column) under the controls of a tape. beside: the effects of the module, or None."""
    recorded = []
    for ctrl in tape:
        if beside:
            beside.step(model, data, ctrl)
        else:
            data.ctrl[:] = ctrl
            mujoco.mj_step(model, data)
        recorded.append(data.sensordata.copy())
    return beside.sense(model, np.array(recorded)) if beside else np.array(recorded)
