"""A bracket per parameter that shrinks around the target (paper, Algorithm 1)."""

import numpy as np


def shrink(
    source: np.ndarray, target: np.ndarray, low: np.ndarray, high: np.ndarray, part: np.ndarray
) -> np.ndarray:
    """Each round lies at `part` (pair, round - 1, parameter) of the bracket that the rounds before it left.

    A round below the target becomes the lower bound of its parameter, any other the upper one. Shapes as in
    `Search.walk`.
    """
    pairs, steps, parameters = part.shape
    path = np.empty((pairs, steps + 1, parameters))
    path[:, 0] = source
    lower, upper = np.broadcast_to(low, source.shape), np.broadcast_to(high, source.shape)
    for i in range(steps):
        below = path[:, i] < target
        lower = np.where(below, path[:, i], lower)
        upper = np.where(below, upper, path[:, i])
        path[:, i + 1] = np.clip(lower + part[:, i] * (upper - lower), lower, upper)
    return path
