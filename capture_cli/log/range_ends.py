"""Where the numbers of a sensor pile up, as they do at the end of its range."""

from math import comb

import numpy as np

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    # quantile of the numbers reported, by size, that counts as the largest: spikes are larger
    largest: float = 0.999
    order: int = 3  # of the differences by which noise is told from motion
    wide: float = 5.0  # standard deviations of the noise: what piles up at a limit is within them
    widest: float = 0.2  # of the largest number
    rounding: float = 1e-6  # of the largest number
    median: float = 0.6745  # of the size of a Gaussian number, in standard deviations
    # times as many samples as next to them, and no fewer: a sine has 2.4
    piled_up: float = 2.5
    fewest: int = 10


def largest_of(reported: np.ndarray) -> float:
    """By size, of numbers (step, number), nan where there is none; 0 of none at all."""
    sizes = np.abs(reported[np.isfinite(reported)])
    return float(np.quantile(sizes, SETTINGS.largest)) if sizes.size else 0.0


def piled_up_from(reported: np.ndarray) -> float:
    """The size from which on numbers (step, number), nan where there is none, are as large as they get, but for noise.

    Infinite where they do not pile up there: neither at one number, as those of a converter, nor about it.
    """
    largest = largest_of(reported)
    columns = [c[np.isfinite(c)] for c in reported.T]
    sizes = np.abs(np.concatenate(columns))
    noise = max((_noise(c) for c in columns if len(c) > SETTINGS.order), default=0.0)
    exactly = SETTINGS.rounding * largest
    width = min(SETTINGS.wide * noise, SETTINGS.widest * largest) + exactly
    next_below = sizes.max(initial=0.0, where=sizes <= largest - exactly)
    is_piled_up = _more(sizes, largest - exactly, next_below - exactly) or _more(
        sizes, largest - width, largest - 2 * width
    )
    return largest - width if is_piled_up else np.inf


def _more(sizes: np.ndarray, edge: float, lower: float) -> bool:
    """Whether more `sizes` (sample,) are above `edge` than from `lower` up to it."""
    top = np.count_nonzero(sizes > edge)
    return top >= max(SETTINGS.fewest, SETTINGS.piled_up * (np.count_nonzero(sizes > lower) - top))


def _noise(series: np.ndarray) -> float:
    """Standard deviation of the noise on a smooth series (step,)."""
    return float(
        np.median(np.abs(np.diff(series, SETTINGS.order)))
        / (SETTINGS.median * np.sqrt(comb(2 * SETTINGS.order, SETTINGS.order)))
    )
