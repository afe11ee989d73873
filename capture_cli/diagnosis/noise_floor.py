"""The noise floor of each output: how far a perfect model would still be from the log.

From high-order differences of the log itself: a difference of order p of a smooth signal vanishes as p grows, while
that of white noise of variance s^2 has variance s^2 (2p)! / (p!)^2. The order is the first after which the estimate
no longer falls. Large differences (impacts, dropped samples) are trimmed. Noise that is not white is underestimated,
and so is said to be something the model lacks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import comb

import numpy as np

ORDERS = range(2, 9)
STILL_FALLING = 0.9  # the signal still shows at an order if the next one gives less than this share
TRIMMED = 0.95  # share of the squared differences that is kept
TRIMMED_MEAN = 0.7588  # mean of a chi-squared(1) variable below its 95 % quantile: P(chi2_3 < q) / 0.95
SMALLEST = 1e-7  # of the output's own standard deviation: floor for logs without noise


@dataclass(frozen=True)
class NoiseFloor:
    """sd (output,) in the outputs' units; source (output,): "declared", "differences" or "resolution"."""

    sd: np.ndarray
    source: tuple[str, ...]


def noise_floor(
    outputs: np.ndarray, episodes: Sequence[slice], declared: Sequence[float | None]
) -> NoiseFloor:
    """Of outputs (step, output); `declared` (output,) are known values, None where there are none."""
    sd, source = [], []
    for k, known in enumerate(declared):
        if known is not None:
            sd.append(known)
            source.append("declared")
            continue
        series = [outputs[steps, k] for steps in episodes]
        by_difference, by_resolution = from_differences(series), resolution(series) / np.sqrt(12)
        spread = float(np.std(outputs[:, k]))
        sd.append(max(by_difference, by_resolution, SMALLEST * spread) or 1.0)
        source.append("resolution" if by_resolution > by_difference else "differences")
    return NoiseFloor(np.array(sd), tuple(source))


def from_differences(series: Sequence[np.ndarray]) -> float:
    """Standard deviation of white noise on smooth series, each (step,)."""
    estimates = []
    for order in ORDERS:
        differences = [np.diff(s, order) for s in series if len(s) > order + 2]
        if not differences:
            break
        squares = np.sort(np.square(np.concatenate(differences)))
        kept = squares[: max(1, int(TRIMMED * len(squares)))]
        estimates.append(float(np.sqrt(kept.mean() / TRIMMED_MEAN / comb(2 * order, order))))
    if not estimates:
        return 0.0
    for this, following in pairwise(estimates):
        if following > STILL_FALLING * this:
            return this
    return estimates[-1]


def resolution(series: Sequence[np.ndarray]) -> float:
    """The step of the grid that the values sit on, or 0 where they sit on none."""
    values = np.unique(np.concatenate(series))
    total = sum(len(s) for s in series)
    if len(values) < 3 or len(values) > total / 4:
        return 0.0
    steps = np.diff(values)
    step = float(steps.min())
    on_grid = np.abs(steps / step - np.round(steps / step)) < 0.02 * np.maximum(steps / step, 1)
    return step if on_grid.mean() > 0.99 else 0.0
