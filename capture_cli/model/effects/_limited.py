"""What is cut off beyond a limit: the kernel, and limits at whose null nothing is."""

import numpy as np

UNLIMITED = 1e10  # N or N m: of an actuator's forcerange that cuts nothing off


def saturated(signal, *, limit):
    """signal, cut off beyond +-limit."""
    return np.clip(signal, -limit, limit)


def unlimited_at(null: float, limits: np.ndarray) -> np.ndarray:
    """`limits`, infinite where they are `null`."""
    return np.where(limits == null, np.inf, limits)
