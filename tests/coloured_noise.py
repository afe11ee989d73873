"""Noise that remembers, for tests of what takes it for something else."""

from __future__ import annotations

import numpy as np


def coloured(
    shape: tuple[int, int], generator: np.random.Generator, *, sd: float, memory: float
) -> np.ndarray:
    """Noise of standard deviation `sd` that forgets within `memory` samples, (repeat, step)."""
    kept = np.exp(-1 / memory)
    noise = generator.standard_normal(shape)
    for k in range(1, shape[1]):
        noise[:, k] = kept * noise[:, k - 1] + np.sqrt(1 - kept**2) * noise[:, k]
    return sd * noise
