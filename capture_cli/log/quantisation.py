"""The steps that a sensor reports in."""

from collections.abc import Sequence

import numpy as np

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    fewest_levels: int = 3
    most_levels: float = 0.25  # of the samples: of a series with more, hardly any value comes twice
    # of the range: levels closer than this are one, but for how it was printed or added up
    finest: float = 1e-6
    tolerance: float = 0.05  # of a step: digits that a file leaves out move levels
    most_off: float = 0.01  # of the levels


def scatter_of_steps(series: Sequence[np.ndarray]) -> float:
    """Standard deviation of what rounding to the sensor's steps adds to series (sample,); 0 where it has none.

    Each series by itself, as an encoder may be set to zero anew before it; or all in one, where they are too short.
    """
    series = [s for s in series if len(s)]
    if not series:
        return 0.0
    return (_common_step(series) or _common_step([np.concatenate(series)]) or 0.0) / np.sqrt(12)


def distinct(values: np.ndarray, span: float | None = None) -> np.ndarray:
    """Sorted `values` without those that are the same as the one before but for rounding.

    span: of all that was rounded to the same steps, of which they may be a part; their own where None.
    """
    apart = np.diff(values) > SETTINGS.finest * (values[-1] - values[0] if span is None else span)
    return values[np.concatenate([[True], apart])]


def grid_step(levels: np.ndarray) -> float | None:
    """The spacing of which all differences of `levels` (sorted) are multiples, None where there is none."""
    return _unit(np.diff(levels)) if len(levels) >= SETTINGS.fewest_levels else None


def _common_step(series: Sequence[np.ndarray]) -> float | None:
    """The step of grids that each series is on, wherever that of each begins; None where there is none."""
    every = np.concatenate(series)
    levels = [distinct(np.unique(s), np.ptp(every)) for s in series]
    if sum(len(own) for own in levels) > SETTINGS.most_levels * len(every):
        return None
    gaps = [np.diff(own) for own in levels if len(own) >= SETTINGS.fewest_levels]
    return _unit(np.concatenate(gaps)) if gaps else None


def _unit(gaps: np.ndarray) -> float | None:
    """What all `gaps` are multiples of, None where of nothing."""
    step = gaps.sum() / np.round(gaps / gaps.min()).sum()
    off = np.abs(gaps / step - np.round(gaps / step))
    return float(step) if np.quantile(off, 1 - SETTINGS.most_off) < SETTINGS.tolerance else None
