"""When an effect is accepted: it must hold on data it was not fitted to, and be worth its parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEVEL = 0.01  # chance of accepting anything where nothing is missing, over all candidates together
SELECT_LEVEL = 0.05  # one-sided, of the paired test on data that was not fitted
RESAMPLES = 4000


@dataclass(frozen=True)
class Support:
    """For one effect: p_fit (corrected for the number of candidates), p_select, and the decrease of BIC."""

    p_fit: float
    p_select: float
    bic_gain: float

    @property
    def reason_against(self) -> str | None:
        """Why the effect is not accepted, or None."""
        if self.p_fit > LEVEL:
            return f"its size cannot be told from zero (p = {self.p_fit:.2g} over all candidates)"
        if self.bic_gain <= 0:
            return f"it is not worth its parameters (BIC rises by {-self.bic_gain:.3g})"
        if self.p_select > SELECT_LEVEL:
            return f"data that was not fitted is not explained better (p = {self.p_select:.2g})"
        return None


def wald_p_value(size: np.ndarray, covariance: np.ndarray, degrees: float, candidates: int) -> float:
    """That amplitudes `size` (amplitude,) differ from null only by chance; Bonferroni over `candidates` tried.

    Hotelling's statistic against F(amplitudes, degrees): the covariance is itself estimated.
    """
    from scipy.special import fdtrc

    count = len(size)
    statistic = float(size @ np.linalg.pinv(covariance, hermitian=True) @ size) / count
    return min(1.0, candidates * float(fdtrc(count, max(degrees, 1.0), statistic)))


def paired_p_value(before: np.ndarray, after: np.ndarray, block: np.ndarray, seed: int) -> float:
    """That squared error (window,) fell from before to after only by chance: bootstrap over blocks, one-sided.

    Blocks are resampled with replacement; with fewer than ten, signs are flipped at random instead (a bootstrap of
    few blocks is too sure of itself).
    """
    _, number = np.unique(block, return_inverse=True)
    fall = np.bincount(number, weights=before - after)
    generator = np.random.default_rng(seed)
    if len(fall) < 10:
        if len(fall) <= 12:
            signs = 1 - 2 * ((np.arange(2 ** len(fall))[:, None] >> np.arange(len(fall))) & 1)
        else:
            signs = generator.choice([-1, 1], size=(RESAMPLES, len(fall)))
        return float(np.mean(signs @ fall >= fall.sum() - 1e-12 * np.abs(fall).sum()))
    drawn = generator.integers(len(fall), size=(RESAMPLES, len(fall)))
    return float((np.sum(fall[drawn].sum(axis=1) <= 0) + 1) / (RESAMPLES + 1))


def bic_gain(before: float, after: float, samples: float, added: int) -> float:
    """Decrease of the Bayesian information criterion by `added` parameters; variance unknown.

    before, after: sums of squared residuals; samples: how many independent ones they are worth.
    """
    return float(samples * np.log(before / after) - added * np.log(max(samples, 2.0)))
