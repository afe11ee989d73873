"""A few that stand for many: windows, episodes or actions, evenly spread from the first to the last."""

import numpy as np


def evenly_spread(count: int, most: int) -> np.ndarray:
    """`most` of `count` things, both at least 1: their indices in order, (index,); all where there are no more."""
    return np.unique(np.linspace(0, count - 1, most).astype(int))
