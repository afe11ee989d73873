"""When an effect is accepted: it must hold on data it was not fitted to, and be worth its parameters."""

from dataclasses import dataclass

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.balance.regression import SETTINGS as REGRESSION
from capture_cli.select.reason import Reason, Rejection


@frozen
class SETTINGS:
    level: float = 0.01  # chance of accepting anything where nothing is missing, over all candidates together
    # one-sided, of the paired test on data that was not fitted, with all other effects in
    select_level: float = 0.05
    # While other effects are still missing the right one need not help everywhere: it may enter, and is
    # judged at the end.
    entry_level: float = 0.25
    entry_ratio: float = 0.9  # of squared errors: or it lowers the whole, if not window by window
    # of squared errors, with all others in: few windows cannot say more steadily that so much is no chance
    halved: float = 0.5
    resamples: int = 4000
    resamples_at_a_time: int = 100  # so that a long log's take some MB
    few_blocks: int = 12  # a bootstrap of so few is too sure of itself
    block_times: int = 2  # a block lasts so many autocorrelation times of the residual
    # and so many steps, as far as that leaves so many blocks: the logarithm of a few squares is mostly chance
    block_steps: int = 16
    blocks: int = 40


@dataclass(frozen=True)
class Support:
    """For one effect: p_fit (corrected for the number of candidates), p_select, the decrease of BIC, and select_ratio,
    the squared error with it over that without it on data that was not fitted; None where nothing judges.
    """

    p_fit: float
    p_select: float | None
    bic_gain: float
    select_ratio: float | None

    def reason_against(self) -> Rejection | None:
        """Why the effect is not accepted, or None."""
        if self.p_select is not None and self.p_select > self._select_level:
            return self._reason_of_fit() or self._not_better()
        return self._reason_of_fit()

    @property
    def _select_level(self) -> float:
        return SETTINGS.entry_level if self.select_ratio < SETTINGS.halved else SETTINGS.select_level

    def reason_against_entry(self) -> Rejection | None:
        """Why the effect may not even enter while others may still be missing, or None."""
        judged = self.p_select is not None
        if judged and self.p_select > SETTINGS.entry_level and self.select_ratio > SETTINGS.entry_ratio:
            return self._reason_of_fit() or self._not_better()
        return self._reason_of_fit()

    def _reason_of_fit(self) -> Rejection | None:
        if self.p_fit > SETTINGS.level:
            return Rejection(Reason.NOT_FROM_ZERO, {"p": self.p_fit})
        if self.bic_gain <= 0:
            return Rejection(Reason.NOT_WORTH_PARAMETERS, {"bic": -self.bic_gain})
        return None

    def _not_better(self) -> Rejection:
        return Rejection(Reason.NOT_BETTER_HELD_OUT, {"p": self.p_select})


def ratio_p_value(before: float, after: float, samples: float, added: int, candidates: int) -> float:
    """That `added` parameters lowered the sum of squares from before to after only by chance.

    The likelihood-ratio (F) test for `samples` independent residuals that the parameters leave free, Bonferroni
    over the `candidates` tried. Unlike a Wald test it is not misled where an amplitude and an inner shape are
    collinear: it asks whether null explains the log, not how well each number is known.
    """
    from scipy.special import fdtrc

    statistic = max(before / max(after, REGRESSION.tiny) - 1, 0.0) * max(samples, 1.0) / added
    return min(1.0, candidates * float(fdtrc(added, max(samples, 1.0), statistic)))


def paired_p_value(before: np.ndarray, after: np.ndarray, seed: int) -> float:
    """That errors fell from before to after (block,), sums of squares, only by chance: paired, one-sided.

    The statistic is the mean logarithm of their ratio over blocks, so that one bad block does not decide alone.
    Blocks are resampled with replacement; few are put to Student's test, which any number of blocks can pass (of four,
    flips of sign make no more than 1 in 16).
    """
    fall = _fall(before, after)
    if len(fall) <= SETTINGS.few_blocks:
        return _student_p_value(fall)
    generator, count = np.random.default_rng(seed), 0
    for _ in range(0, SETTINGS.resamples, SETTINGS.resamples_at_a_time):
        drawn = generator.integers(len(fall), size=(SETTINGS.resamples_at_a_time, len(fall)))
        count += int(np.sum(fall[drawn].sum(axis=1) <= 0))
    return float((count + 1) / (SETTINGS.resamples + 1))


def _student_p_value(fall: np.ndarray) -> float:
    """That the mean of `fall` (block,) is above zero only by chance; 1 where there is one block.

    Not scipy.stats.ttest_1samp, of which that is nan, as it is where nothing changed; and scipy.stats loads for 0.5 s.
    """
    from scipy.special import stdtr

    if len(fall) < 2:
        return 1.0
    error = max(float(np.std(fall, ddof=1)) / np.sqrt(len(fall)), REGRESSION.tiny)
    return float(stdtr(len(fall) - 1, -fall.mean() / error))


def bic_gain(before: float, after: float, samples: float, added: int) -> float:
    """Decrease of the Bayesian information criterion by `added` parameters; variance unknown.

    before, after: sums of squared residuals; samples: how many independent ones they are worth.
    """
    return float(samples * _fall(before, after) - added * np.log(max(samples, 2.0)))


def _fall(before: np.ndarray | float, after: np.ndarray | float) -> np.ndarray | float:
    """Logarithm of the ratio of sums of squares, of which either may be nothing: a perfect fit."""
    return np.log(np.maximum(before, REGRESSION.tiny)) - np.log(np.maximum(after, REGRESSION.tiny))
