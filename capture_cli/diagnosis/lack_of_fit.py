"""Is anything left that the noise does not explain?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_cli.linearization import Linearization, autocorrelation_time

PRACTICAL = 1.1  # error over the noise floor below which nobody would look for a missing effect
NEAR_FLOOR = 1.2  # the same on what was held out, up to which a model counts as the explanation
FLOOR_SHARE = 2.0  # variance of a floor from second differences over that of a mean square: 1.9
FLOOR_UNCERTAINTY = 0.03  # of the noise floor's own standard deviation, on top of its sampling error
Z = 3.0  # one-sided, p = 0.0013


@dataclass(frozen=True)
class LackOfFit:
    """normalized: RMSE over the noise floor. threshold: what chance allows. lacking: whether it is beyond."""

    normalized: float
    threshold: float
    autocorrelation_time: float
    lacking: bool


def lack_of_fit(at: Linearization) -> LackOfFit:
    """Compare the residual of a fit, in units of the noise, with its degrees of freedom.

    Under the null the residual is the noise, which the floor takes to be white: the ratio of their squares has mean 1
    and variance 2 / n, plus FLOOR_SHARE times as much, as the floor is itself estimated from these samples. The
    autocorrelation time is reported only: a residual that is not white is no reason to ask for less.
    """
    evidence = at.evidence
    degrees = max(evidence.count - len(at.x) - at.fitted_starts, 1.0)
    normalized = float(np.sqrt(np.square(at.residual).sum() / degrees))
    threshold = max(by_chance(degrees), PRACTICAL)
    time = autocorrelation_time(at.residual.reshape(evidence.measured.shape), evidence.mask)
    return LackOfFit(normalized, threshold, time, normalized > threshold)


def holds(normalized: float, count: int) -> bool:
    """Whether an error over the noise floor on `count` numbers that were held out is that of a model that explains."""
    return normalized <= max(NEAR_FLOOR, by_chance(count))


def by_chance(degrees: float) -> float:
    """What an error over the noise floor may come to where only noise is left, with so many degrees of freedom."""
    spread = np.sqrt(2 / degrees * (1 + FLOOR_SHARE) + (2 * FLOOR_UNCERTAINTY) ** 2)
    return float(np.sqrt(1 + Z * spread))
