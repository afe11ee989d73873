"""Refinement where a round shows a label, which has no slope: the likelihood of every value of the one parameter.

What label an action gives is a piecewise constant function of the parameter. Its changes are found by bisection with
the simulator, over the values that are still possible; between two values with the same label it is taken to be the
same. How often a measured label is wrong is estimated with the parameter.
"""

from __future__ import annotations

import numpy as np

from capture_cli.identifiers._learned import Prediction
from capture_cli.identifiers.rounds import Signature, Simulate, finite

VALUES = 257  # of the parameter, in all its range
ERROR_RATES = np.array([1e-3, 0.03, 0.1, 0.2, 0.3])  # of measured labels, equally likely beforehand
LABELS = 3
NEGLIGIBLE = 1e-3  # share of the posterior, in all, that is not looked at
PRIOR_SHARE = 0.5  # of the transformer; the rest is uniform, for where it is wrong


class LabelRefinement:
    """Refines the estimates of `pairs` pairs of one parameter; used like `Refinement`."""

    def __init__(self, signature: Signature, pairs: int, simulate: Simulate):
        self.signature = signature
        self.simulate = simulate
        self.rollouts = np.zeros(pairs, dtype=np.int64)
        self._values = np.linspace(0, 1, VALUES)
        self._log_likelihood = np.zeros((pairs, len(ERROR_RATES), VALUES))

    def refine(self, prior: Prediction, asked, actions, simulated, measured) -> Prediction:
        """The estimate after one more round (the posterior's median) and its variance, in the task's units."""
        space = self.signature.space
        mean = space.to_unit(prior.mean)
        variance = prior.covariance[:, 0] / space.span**2
        before = self._posterior(mean, variance)
        labels = self._labels(before, actions)
        right = (labels == measured[:, -1])[:, None]
        rate = ERROR_RATES[:, None]
        self._log_likelihood += np.log(np.where(right, 1 - rate, rate / (LABELS - 1)))
        posterior = self._posterior(mean, variance)
        cumulative = np.cumsum(posterior, axis=1)
        median = self._values[np.argmax(cumulative >= 0.5, axis=1)]
        spread = posterior @ np.square(self._values) - np.square(posterior @ self._values)
        return Prediction(space.from_unit(median[:, None]), (spread[:, None] * space.span**2)[..., None])

    def _posterior(self, mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
        """Of each value (pair, value), over all error rates."""
        log = self._log_likelihood
        likelihood = np.exp(log - log.max(axis=(1, 2), keepdims=True)).sum(axis=1)
        gaussian = np.exp(-np.square(self._values - mean) / (2 * np.maximum(variance, 1 / VALUES**2)))
        gaussian /= np.maximum(gaussian.sum(axis=1, keepdims=True), 1e-300)
        product = likelihood * (PRIOR_SHARE * gaussian + (1 - PRIOR_SHARE) / VALUES)
        return product / product.sum(axis=1, keepdims=True)

    def _labels(self, posterior: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """The label that each value would give under the action (pair, value); NaN where it does not matter."""
        cumulative = np.cumsum(posterior, axis=1)
        low = np.argmax(cumulative > NEGLIGIBLE / 2, axis=1)
        high = np.argmax(cumulative >= 1 - NEGLIGIBLE / 2, axis=1)
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
        return _extended(labels, low, high)

    def _look(self, labels: np.ndarray, pair: np.ndarray, value: np.ndarray, actions: np.ndarray) -> None:
        if not len(pair):
            return
        parameters = self.signature.space.from_unit(self._values[value][:, None])
        labels[pair, value] = finite(*self.simulate(parameters, actions[pair]))[:, -1, 0]
        np.add.at(self.rollouts, pair, 1)


def _extended(labels: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Values outside of [low, high] (pair,) take the label of the nearest end."""
    index = np.clip(np.arange(labels.shape[1]), low[:, None], high[:, None])
    return np.take_along_axis(labels, index, axis=1)
