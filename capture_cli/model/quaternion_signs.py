"""An attitude is two quaternions, q and -q. Which of them a device reports, or a simulation gives, means nothing."""

from collections.abc import Sequence

import mujoco
import numpy as np

QUATERNIONS = (mujoco.mjtSensor.mjSENS_FRAMEQUAT, mujoco.mjtSensor.mjSENS_BALLQUAT)


def is_quaternion(model: mujoco.MjModel, sensor: int) -> bool:
    """Whether the sensor reports an orientation, which cannot be shifted or scaled number by number."""
    return mujoco.mjtSensor(int(model.sensor_type[sensor])) in QUATERNIONS


def quaternion_columns(model: mujoco.MjModel, sensors: Sequence[int]) -> list[np.ndarray]:
    """Which outputs make up each attitude, (4,) each. sensors (output,): the sensor of each output, by id."""
    attitudes = dict.fromkeys(s for s in sensors if is_quaternion(model, s))
    return [np.flatnonzero(np.asarray(sensors) == s) for s in attitudes]


def continuous(
    outputs: np.ndarray,
    episodes: Sequence[slice],
    attitudes: Sequence[np.ndarray],
    sampled: np.ndarray | None = None,
) -> np.ndarray:
    """Outputs (step, output) in which no attitude jumps from q to -q within an episode.

    sampled (step, output): where they have a sample; everywhere where None.
    """
    if not attitudes:
        return outputs
    sampled = np.ones(outputs.shape, dtype=bool) if sampled is None else sampled
    outputs = outputs.copy()
    for columns in attitudes:
        for steps in episodes:
            own = steps.start + np.flatnonzero(sampled[steps, columns[0]])
            series = outputs[np.ix_(own, columns)]
            turned = np.einsum("ti,ti->t", series[1:], series[:-1]) < 0
            signs = np.cumprod(np.where(turned, -1.0, 1.0))
            outputs[np.ix_(own[1:], columns)] = series[1:] * signs[:, None]
    return outputs


def aligned(simulated: np.ndarray, measured: np.ndarray, attitudes: Sequence[np.ndarray]) -> np.ndarray:
    """Simulated outputs (..., window, step, output) with the attitudes' signs of `measured` (window, step, output)."""
    if not attitudes:
        return simulated
    simulated = simulated.copy()
    for columns in attitudes:
        cosine = (simulated[..., columns] * measured[..., columns]).sum(axis=-1, keepdims=True)
        simulated[..., columns] *= np.where(cosine < 0, -1.0, 1.0)
    return simulated
