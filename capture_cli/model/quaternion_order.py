"""In which order the four columns of an attitude are: MuJoCo's is w, x, y, z; ROS, SciPy and Unity write x, y, z, w."""

import re
from collections.abc import Sequence

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    # Which of four columns are w, x, y and z
    w_first: tuple[int, ...] = (0, 1, 2, 3)
    w_last: tuple[int, ...] = (3, 0, 1, 2)
    small: float = 0.2  # of length 1: a body that leans by less than 33 degrees
    large: float = 0.7


def order_in_names(columns: Sequence[str]) -> tuple[int, ...] | None:
    """Which of four columns are w, x, y and z, by the letters that their names end in; None where they do not."""
    ends = [re.sub(r"\W+$", "", name)[-1:].lower() for name in columns]
    return tuple(map(ends.index, "wxyz")) if sorted(ends) == sorted("wxyz") else None


def is_w_last(values: np.ndarray, model: mujoco.MjModel, sensor: int) -> bool:
    """Whether an attitude (sample, 4) is one of a body that stays upright if w is its last number: read with w first,
    it is half a turn away from that all the time.

    sensor: the id of what reports it. False where the model itself is so in its reference pose or in a keyframe.
    """
    return _half_a_turn_away(values) and not any(_half_a_turn_away(p[None]) for p in _poses(model, sensor))


def _half_a_turn_away(values: np.ndarray) -> bool:
    """Whether of attitudes (sample, 4), w first, the first two stay near 0, and the last is near +-1 at some time."""
    length = np.linalg.norm(values, axis=1)
    with np.errstate(invalid="ignore"):
        unit = np.abs(values[length > 0] / length[length > 0, None])
    return bool(len(unit) and (unit[:, :2] < SETTINGS.small).all() and (unit[:, 3] > SETTINGS.large).any())


def _poses(model: mujoco.MjModel, sensor: int) -> np.ndarray:
    """What the sensor says in the model's reference pose and in its keyframes, (pose, 4)."""
    data, first = mujoco.MjData(model), int(model.sensor_adr[sensor])
    said = []
    for key in range(-1, model.nkey):
        mujoco.mj_resetDataKeyframe(model, data, key)  # the reference pose where there is no such
        mujoco.mj_forward(model, data)
        said.append(data.sensordata[first : first + 4].copy())
    return np.array(said)
