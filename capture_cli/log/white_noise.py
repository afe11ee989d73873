"""Noise on smooth series, by high-order differences.

A difference of order p of a smooth signal vanishes as p grows, while that of white noise of variance s^2 has variance
s^2 (2p)! / (p!)^2. The order is the first after which the estimate no longer falls. Large differences (impacts, dropped
samples) are trimmed.

Noise that a low-pass has passed is smooth, too: the estimate falls with every order. Then its spectrum tells
(noise_spectrum.py).
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import comb

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.log.noise_spectrum import filtered_noise

ORDERS = range(2, 9)


@frozen
class SETTINGS:
    # the signal still shows at an order if the next one gives less than this share
    still_falling: float = 0.9
    trimmed: float = 0.95  # share of the squared differences that is kept
    # the largest kept of few lies a little above the quantile of the share that they are
    place: float = 1 / 3
    uneven: float = 0.01  # of the sampling interval: files round times


def trimmed_sd(numbers: np.ndarray) -> float:
    """The standard deviation of Gaussian `numbers`, the largest left out."""
    kept = max(1, int(SETTINGS.trimmed * len(numbers)))
    squares = np.sort(np.square(numbers))[:kept]
    return float(np.sqrt(squares.mean() / _mean_below((kept + SETTINGS.place) / len(numbers))))


def _mean_below(share: float) -> float:
    """The mean of a chi-squared variable of one degree below its quantile q of `share`: P(chi2_3 < q) / share."""
    from scipy.special import chdtr, chdtri

    return float(chdtr(3, chdtri(1, 1 - share))) / share if share < 1 else 1.0


def from_differences(series: Sequence[np.ndarray], times: Sequence[np.ndarray]) -> float:
    """Standard deviation of white or filtered noise on smooth series, each (step,), sampled at `times` (step,), s."""
    return noise_and_spacing([series], [times])[0][0]


def noise_and_spacing(
    series: Sequence[Sequence[np.ndarray]], times: Sequence[Sequence[np.ndarray]]
) -> list[tuple[float, int]]:
    """Of each channel what `from_differences` says, and of how many samples one has noise of its own: 1 of white
    noise.
    """
    white = [white_noise(own, there) for own, there in zip(series, times, strict=True)]
    rest = [k for k, noise in enumerate(white) if noise is None]
    filtered = dict(zip(rest, filtered_noise([series[k] for k in rest]), strict=True))
    found = []
    for k, noise in enumerate(white):
        if noise is not None:
            found.append((noise, 1))
        else:
            found.append(filtered[k] or ((_by_order(series[k], times[k]) or [0.0])[-1], 1))
    return found


def white_noise(series: Sequence[np.ndarray], times: Sequence[np.ndarray]) -> float | None:
    """As `from_differences`; None where the estimate keeps falling: then the series is smooth rather than noisy."""
    return next(_settled(_by_order(series, times)), None)


def _by_order(series: Sequence[np.ndarray], times: Sequence[np.ndarray]) -> list[float]:
    """The estimates by differences of each order, as long as there are any."""
    estimates = []
    for order in ORDERS:
        found = [differences(s, t, order) for s, t in zip(series, times, strict=True) if len(s) > order + 2]
        if not found:
            break
        estimates.append(trimmed_sd(np.concatenate(found)))
    return estimates


def _settled(estimates: Sequence[float]) -> Iterator[float]:
    """Those that the next order does not lower any more."""
    return (this for this, following in pairwise(estimates) if following > SETTINGS.still_falling * this)


def differences(series: np.ndarray, time: np.ndarray, order: int) -> np.ndarray:
    """Differences (step - order,) of a series (step,), scaled such that white noise keeps its variance.

    Divided differences where samples are not evenly spaced: a polynomial of lower degree vanishes there, too.
    """
    steps = np.diff(time)
    if np.ptp(steps) < SETTINGS.uneven * np.median(steps):
        return np.diff(series, order) / np.sqrt(comb(2 * order, order))
    points = np.lib.stride_tricks.sliding_window_view(time, order + 1)
    apart = (points[:, :, None] - points[:, None, :]) / np.median(steps) + np.eye(order + 1)
    weights = 1 / apart.prod(axis=2)
    weights /= np.linalg.norm(weights, axis=1)[:, None]
    return (weights * np.lib.stride_tricks.sliding_window_view(series, order + 1)).sum(axis=1)
