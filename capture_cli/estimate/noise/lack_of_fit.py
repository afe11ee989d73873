"""Is anything left that the noise does not explain?

Asked of all outputs together, and of each: one that is badly wrong among many that are right hardly shows in their
mean.
"""

from dataclasses import dataclass

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.noise.autocorrelation import autocorrelation_time
from capture_cli.estimate.solve.linearization import Data, Linearization


@frozen
class SETTINGS:
    # Error over the noise floor below which nobody would look for a missing effect: of all outputs, and of
    # one of them
    practical: float = 1.1
    practical_of_one: float = 1.2
    # The same on what was held out, up to which a model counts as the explanation
    near_floor: float = 1.2
    near_floor_of_one: float = 1.3
    floor_share: float = 2.0  # variance of a floor from second differences over that of a mean square: 1.9
    # of the noise floor's own standard deviation, on top of its sampling error
    floor_uncertainty: float = 0.03
    z: float = 3.0  # one-sided, p = 0.0013


@dataclass(frozen=True)
class LackOfFit:
    """normalized: RMSE over the noise floor. threshold: what chance allows. outputs, output_thresholds (output,):
    likewise of each; an output without samples has 0.
    """

    normalized: float
    threshold: float
    autocorrelation_time: float
    outputs: np.ndarray
    output_thresholds: np.ndarray

    @property
    def lacking(self) -> bool:
        """Whether all outputs together, or one of them, are beyond."""
        return self.normalized > self.threshold or self.beyond is not None

    @property
    def beyond(self) -> int | None:
        """The output that is farthest beyond what chance allows of it, None where none is."""
        over = self.outputs / self.output_thresholds
        worst = int(np.argmax(over))
        return worst if over[worst] > 1 else None

    @property
    def is_near(self) -> bool:
        """Whether what is left is little enough for the model to count as the explanation."""
        return not self.lacking or (
            self.normalized <= SETTINGS.near_floor and self.outputs.max() <= SETTINGS.near_floor_of_one
        )


def lack_of_fit(at: Linearization, residual: np.ndarray | None = None) -> LackOfFit:
    """Compare the residual of a fit, in units of the noise, with its degrees of freedom.

    residual (window, row): instead of its own, as of another noise.

    Under the null the residual is the noise, which the floor takes to be white: the ratio of their squares has mean 1
    and variance 2 / n, plus `floor_share` times as much, as the floor is itself estimated from these samples. The
    autocorrelation time is reported only: a residual that is not white is no reason to ask for less.
    """
    spent = len(at.x) + at.fitted_initial
    residual = at.residual if residual is None else residual
    return _compared(at.data, residual, spent, SETTINGS.practical, SETTINGS.practical_of_one)


def lack_held_out(data: Data, residual: np.ndarray) -> LackOfFit:
    """Of what was held out, of which a model that did not see it leaves residual (window, row); nothing lacks nothing.

    A model counts as the explanation up to `near_floor`: its parameters are not exact.
    """
    return _compared(data, residual, 0.0, SETTINGS.near_floor, SETTINGS.near_floor_of_one)


def _compared(
    data: Data,
    residual: np.ndarray,
    spent: float,
    practical: float,
    practical_of_one: float,
) -> LackOfFit:
    """spent: degrees of freedom that the fit took, each output's share by its samples."""
    counts = _together(data, data.mask.sum(axis=(0, 1)))
    shaped = residual.reshape(data.measured.shape)
    squares = _together(data, np.square(shaped).sum(axis=(0, 1)))
    share = max(1 - spent / max(data.count, 1), 1 / max(data.count, 1))
    degrees = np.maximum(counts * share, 1.0)
    total = max(data.count * share, 1.0)
    return LackOfFit(
        float(np.sqrt(np.square(residual).sum() / total)),
        float(max(by_chance(total), practical)),
        autocorrelation_time(shaped, data.mask),
        np.sqrt(squares / degrees),
        np.maximum(by_chance(degrees, of=len(counts)), practical_of_one),
    )


def _together(data: Data, sums: np.ndarray) -> np.ndarray:
    """Sums (output,), with those of the four numbers of each attitude replaced by what they come to together."""
    sums = sums.astype(float)
    for columns in data.attitudes:
        sums[columns] = sums[columns].sum()
    return sums


def by_chance(degrees: float | np.ndarray, of: int = 1) -> float | np.ndarray:
    """What an error over the noise floor may come to where only noise is left, with so many degrees of freedom.

    of: how many such errors are looked at, of which the largest may not be beyond more often than one alone.
    """
    from scipy.special import ndtr, ndtri

    z = SETTINGS.z if of == 1 else -ndtri(ndtr(-SETTINGS.z) / of)
    spread = np.sqrt(2 / degrees * (1 + SETTINGS.floor_share) + (2 * SETTINGS.floor_uncertainty) ** 2)
    return np.sqrt(1 + z * spread)
