"""The steps that a sensor reports in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

FEWEST_LEVELS = 3
MOST_LEVELS = 0.25  # of the samples: of a series with more, hardly any value comes twice
FINEST = 1e-6  # of the range: levels closer than this are one, but for how it was printed or added up
TOLERANCE = 0.05  # of a step: digits that a file leaves out move levels
MOST_OFF = 0.01  # of the levels


def scatter_of_steps(series: Sequence[np.ndarray]) -> float:
    """Standard deviation of what rounding to the sensor's steps adds to series (sample,); 0 where it has none."""
    values = np.unique(np.concatenate(series))
    levels = distinct(values)
    if len(levels) > MOST_LEVELS * sum(len(s) for s in series):
        return 0.0
    return (grid_step(levels) or 0.0) / np.sqrt(12)


def distinct(values: np.ndarray) -> np.ndarray:
    """Sorted `values` without those that are the same as the one before but for rounding."""
    apart = np.diff(values) > FINEST * (values[-1] - values[0])
    return values[np.concatenate([[True], apart])]


def grid_step(levels: np.ndarray) -> float | None:
    """The spacing of which all differences of `levels` (sorted) are multiples, None where there is none."""
    if len(levels) < FEWEST_LEVELS:
        return None
    gaps = np.diff(levels)
    step = gaps.sum() / np.round(gaps / gaps.min()).sum()
    off = np.abs(gaps / step - np.round(gaps / step))
    return float(step) if np.quantile(off, 1 - MOST_OFF) < TOLERANCE else None
