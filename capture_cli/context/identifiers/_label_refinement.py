"""Refinement where a round shows a label, which has no slope: the posterior of every value of the one parameter.

What label an action gives is a piecewise constant function of the parameter. Its changes are found by bisection with
the simulator, over the values that are still possible; between two values with the same label it is taken to be the
same. How often a measured label is wrong is estimated with the parameter.

An estimate is as good as the action chosen for it. Of each value it is seen, too, which others its action would not
tell from it: the estimate is the value that holds most of the posterior in these, and what is asked for next is the
value after whose label the estimate is expected to hold most.

What the transformer says is made of the same labels. They are read once, off the simulator: a prior that has seen
them too would count them twice, and be as sure of a wrong one as of a right one.
"""

from collections.abc import Callable

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.quantities import NORMAL_QUANTILE
from capture_cli.context.identifiers._learned import Prediction
from capture_cli.context.identifiers.base import Rounds, Signature, Simulate, finite


@frozen
class SETTINGS:
    values: int = 513  # of the parameter, in all its range
    labels: int = 3
    questions: int = 15  # quantiles of the posterior, looked at beside the estimate
    negligible: float = 1e-3  # share of the posterior, in all, that is not looked at
    as_good: float = 1 - 1e-9  # stretches that hold this much of the most are as good
    covered: float = 0.95
    halvings: int = 20  # of the range, until an interval is known


# how often a measured label is wrong, and how likely that is beforehand: as like as not, never
ERROR_RATES = np.array([1e-3, 0.03, 0.1, 0.2, 0.3])
RATE_PRIOR = np.array([0.5, 0.125, 0.125, 0.125, 0.125])


class LabelRefinement:
    """Refines the estimates of `pairs` pairs of one parameter; used like `Refinement`.

    error_rate: how often a label of round n (0, 1, ...) is wrong, where that is known; estimated otherwise.
    """

    def __init__(
        self, signature: Signature, pairs: int, simulate: Simulate, error_rate: Callable[[int], float] | None
    ):
        self.signature = signature
        self.simulate = simulate
        self.error_rate = error_rate
        self.rollouts = np.zeros(pairs, dtype=np.int64)
        self._round = 0
        self._values = np.linspace(0, 1, SETTINGS.values)
        # what an action does not tell from the value that it was chosen for, in values: half the length of the
        # shortest stretch seen, unknown at first; and how far its middle is off, about values that were asked for
        self._reach = np.full((pairs, 1), np.inf)
        self._off = np.zeros((pairs, SETTINGS.values))
        self._nearest = np.full((pairs, SETTINGS.values), np.inf)  # of these, from each value
        prior = RATE_PRIOR if error_rate is None else np.ones(1)
        self._log = np.tile(np.log(prior)[None, :, None], (pairs, 1, SETTINGS.values))

    def refine(self, prior: Prediction, asked, actions, simulated, measured) -> Prediction:
        """The estimate after one more round and its variance, in the task's units.

        The estimate is the value that holds most with those that its action does not tell from it. Its standard
        deviation is that of a Gaussian whose 95 % interval is as wide as the one about the estimate that holds 95 %.
        prior: not used, it is made of the same labels.
        """
        space = self.signature.space
        self._weigh(asked, actions, measured)
        cumulative = np.cumsum(self._posterior(), axis=1)
        estimate = self._fullest(cumulative)
        sd = _half_width(cumulative, estimate) / NORMAL_QUANTILE * space.span
        return Prediction(space.from_unit(estimate[:, None]), np.square(sd)[:, None, None])

    def question(self, estimate: np.ndarray) -> np.ndarray:
        """What to ask for next (pair, parameter): the value after whose label the next estimate is expected to hold
        most; the estimate itself (pair, parameter) where none is better.
        """
        space = self.signature.space
        joint, rate = self._joint(), self._rates()[:, None]
        right, wrong = (joint * (1 - rate)).sum(axis=1), (joint * rate).sum(axis=1) / (SETTINGS.labels - 1)
        cumulative = np.cumsum(joint.sum(axis=1), axis=1)
        shares = (np.arange(SETTINGS.questions) + 0.5) / SETTINGS.questions
        quantiles = [(cumulative < share).sum(axis=1, keepdims=True) for share in shares]
        asked = np.stack([space.to_unit(estimate) * (SETTINGS.values - 1), *quantiles])
        expected = np.stack([self._expected(each, right, wrong) for each in asked])
        expected[0] /= SETTINGS.as_good
        best = expected.argmax(axis=0)
        chosen = np.take_along_axis(asked, best[None, :, None], axis=0)[0] / (SETTINGS.values - 1)
        return np.where(best[:, None] == 0, estimate, space.from_unit(chosen))

    def recall(self, earlier: Rounds) -> None:
        """Weigh the rounds that were made before."""
        for n in range(earlier.rounds):
            self._weigh(earlier.parameters[:, n], earlier.actions[:, n], earlier.measured[:, n])

    def _weigh(self, asked, actions, measured) -> None:
        """Multiply the posterior by what a round says."""
        labels = self._labels(self._posterior(), actions)
        self._resolve(labels, self.signature.space.to_unit(asked)[:, 0])
        right = (labels == measured[:, -1])[:, None]
        rate = self._rates()[:, None]
        self._log += np.log(np.where(right, 1 - rate, rate / (SETTINGS.labels - 1)))
        self._round += 1

    def _posterior(self) -> np.ndarray:
        """Of each value (pair, value), over all error rates."""
        return self._joint().sum(axis=1)

    def _joint(self) -> np.ndarray:
        """Of each error rate and value, (pair, rate, value)."""
        joint = np.exp(self._log - self._log.max(axis=(1, 2), keepdims=True))
        return joint / joint.sum(axis=(1, 2), keepdims=True)

    def _rates(self) -> np.ndarray:
        """How often the next label may be wrong (rate,)."""
        return ERROR_RATES if self.error_rate is None else np.array([self.error_rate(self._round)])

    def _expected(self, asked: np.ndarray, right: np.ndarray, wrong: np.ndarray) -> np.ndarray:
        """What the estimate is expected to hold (pair,) after the label of a value `asked` for (pair, 1).

        right, wrong: the posterior (pair, value) times how likely the right label is, and each of the others. Below
        and above what the action does not tell from the value it is taken to give one label each.
        """
        off = np.take_along_axis(self._off, np.rint(asked).astype(int), axis=1)
        beside = np.arange(SETTINGS.values) - asked - off
        side = np.where(np.abs(beside) <= self._half(), 0, np.sign(beside))
        after = (np.cumsum(np.where(side == label, right, wrong), axis=1) for label in (-1, 0, 1))
        return sum(self._held(cumulative).max(axis=1) for cumulative in after)

    def _resolve(self, labels: np.ndarray, asked: np.ndarray) -> None:
        """Which values an action did not tell from the one `asked` for (pair,): those between two changes of the label.

        Actions for other values are taken to do alike, as that for the nearest does.
        """
        at, index = asked[:, None] * (SETTINGS.values - 1), np.arange(SETTINGS.values)
        other = labels != np.take_along_axis(labels, np.rint(at).astype(int), axis=1)
        below = np.where(other & (index < at), index, -1).max(axis=1, keepdims=True)
        above = np.where(other & (index > at), index, SETTINGS.values).min(axis=1, keepdims=True)
        between, away = (below >= 0) & (above < SETTINGS.values), np.abs(index - at)
        self._reach = np.where(between, np.minimum(self._reach, (above - below - 1) / 2), self._reach)
        nearest = between & (away <= self._nearest)
        self._off = np.where(nearest, (above + below) / 2 - at, self._off)
        self._nearest = np.where(nearest, away, self._nearest)

    def _fullest(self, cumulative: np.ndarray) -> np.ndarray:
        """The value (pair,) that holds most; of several side by side, the middle."""
        index = np.arange(SETTINGS.values)
        held = self._held(cumulative)
        best = held >= SETTINGS.as_good * held.max(axis=1, keepdims=True)
        first = np.argmax(best, axis=1)
        after = np.where(~best & (index > first[:, None]), index, SETTINGS.values).min(axis=1)
        return (self._values[first] + self._values[after - 1]) / 2

    def _held(self, cumulative: np.ndarray) -> np.ndarray:
        """What each value holds (pair, value): the posterior of those that its action does not tell from it."""
        middle, half = np.arange(SETTINGS.values) + self._off, self._half()
        return _up_to(cumulative, middle + half) - _up_to(cumulative, middle - half)

    def _half(self) -> np.ndarray:
        """Half the length (pair, 1) of what an action does not tell apart, that of one value where it is not known."""
        return np.where(np.isfinite(self._reach), self._reach, 0.5)

    def _labels(self, posterior: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """The label that each value would give under the action (pair, value); NaN where it does not matter."""
        cumulative = np.cumsum(posterior, axis=1)
        low = np.argmax(cumulative > SETTINGS.negligible / 2, axis=1)
        high = np.argmax(cumulative >= 1 - SETTINGS.negligible / 2, axis=1)
        labels = np.full(posterior.shape, np.nan)
        pair = np.arange(len(labels))
        self._look(labels, np.concatenate([pair, pair]), np.concatenate([low, high]), actions)
        intervals = np.stack([pair, low, high], axis=1)
        while len(intervals):
            intervals = intervals[intervals[:, 2] - intervals[:, 1] > 1]
            k, a, b = intervals.T
            same = labels[k, a] == labels[k, b]
            for row, first, last in intervals[same]:
                labels[row, first:last] = labels[row, first]
            k, a, b = intervals[~same].T
            middle = (a + b) // 2
            self._look(labels, k, middle, actions)
            intervals = np.concatenate([np.stack([k, a, middle], axis=1), np.stack([k, middle, b], axis=1)])
        # values outside of [low, high] take the label of the nearest end
        nearest = np.clip(np.arange(labels.shape[1]), low[:, None], high[:, None])
        return np.take_along_axis(labels, nearest, axis=1)

    def _look(self, labels: np.ndarray, pair: np.ndarray, value: np.ndarray, actions: np.ndarray) -> None:
        if not len(pair):
            return
        parameters = self.signature.space.from_unit(self._values[value][:, None])
        labels[pair, value] = finite(*self.simulate(parameters, actions[pair]))[:, -1, 0]
        np.add.at(self.rollouts, pair, 1)


def _up_to(cumulative: np.ndarray, place: np.ndarray) -> np.ndarray:
    """How much of a posterior lies below `place` (pair, n), in values, each of which stands for the cell about it."""
    padded = np.pad(cumulative, ((0, 0), (1, 0)))
    place = np.clip(place + 0.5, 0, SETTINGS.values)
    cell = np.minimum(place.astype(int), SETTINGS.values - 1)
    before, after = (np.take_along_axis(padded, edge, axis=1) for edge in (cell, cell + 1))
    return before + (place - cell) * (after - before)


def _half_width(cumulative: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Half the width (pair,) of the interval about `middle` (pair,) that holds 95 % of a posterior.

    Each value stands for the cell of values that are nearest to it.
    """
    edges = np.concatenate([[0], (np.arange(SETTINGS.values - 1) + 0.5) / (SETTINGS.values - 1), [1]])
    below = np.pad(cumulative, ((0, 0), (1, 0)))
    low, high = np.zeros(len(middle)), np.ones(len(middle))
    for _ in range(SETTINGS.halvings):
        half = (low + high) / 2
        ends = zip(below, middle - half, middle + half, strict=True)
        held = np.array([np.interp(right, edges, f) - np.interp(left, edges, f) for f, left, right in ends])
        too_few = held < SETTINGS.covered
        low, high = np.where(too_few, half, low), np.where(too_few, high, half)
    return high
