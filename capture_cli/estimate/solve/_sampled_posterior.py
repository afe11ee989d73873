"""How sure an estimate is where contacts make the error rough: by sampling, not by the curvature at its bottom.

There the curvature says how steep the nearest bump is, and the bottom may be one of many. Points are drawn about the
estimate on several scales, simulated, and weighed by their likelihood over the density that all of them were drawn
from; the next are drawn from what these say (adaptive multiple importance sampling; Cornuet, Marin, Mira and Robert
2012). While few points carry the weight the likelihood is tempered, so that an answer is too wide rather than too sure.

For windows whose initial states are known, as others would have to be fitted at every point, and one or two parameters:
of five, so few points collapse onto some of them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.solve.linearization import Linearization, Trial, trial_objectives


@frozen
class SETTINGS:
    known: float = 1.0  # free numbers, at most, that known initial states amount to
    away: float = 2.0  # sd: where the error is compared with its parabola
    ratio: float = 1.5  # times: by as much they may differ
    most_parameters: int = 2  # of more so few points say too little
    scales: tuple[float, ...] = (1.0, 4.0, 16.0, 64.0)  # times the sd by the curvature, of the first points
    points: int = 32  # of a round
    rounds: int = 4
    wider: float = 1.5  # times the sd that the points so far say, of the next
    # of the range, that points are drawn with
    largest_sd: float = 0.3
    smallest_sd: float = 1e-5
    enough: float = 12.0  # points that carry the weight (Kish's effective size)
    # steps of the temperature, and where they end
    cooler: float = 0.8
    coldest: float = 1e-3


# What trials show: outputs (candidate, window, step, output), and what diverged (candidate, window).
Evaluate = Callable[[Trial], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class SampledPosterior:
    """mean (p,), covariance (p, p), in the unit cube. point (parameter,): the likeliest that was simulated; gain: by
    how much its objective is below that of the estimate, over k.
    """

    mean: np.ndarray
    covariance: np.ndarray
    point: np.ndarray
    gain: float


@dataclass(frozen=True)
class _Proposal:
    """A normal distribution that `count` points were drawn from. Beyond the unit cube the posterior is nothing."""

    mean: np.ndarray
    covariance: np.ndarray
    count: int

    @classmethod
    def about(cls, mean: np.ndarray, covariance: np.ndarray, count: int) -> Self:
        values, vectors = np.linalg.eigh(covariance)
        values = np.clip(values, SETTINGS.smallest_sd**2, SETTINGS.largest_sd**2)
        return cls(mean, (vectors * values) @ vectors.T, count)

    def draw(self, generator: np.random.Generator) -> np.ndarray:
        """(point, p)."""
        off = generator.standard_normal((self.count, len(self.mean))) @ np.linalg.cholesky(self.covariance).T
        return self.mean + off

    def density(self, x: np.ndarray) -> np.ndarray:
        """At x (point, p), but for what all proposals have in common."""
        off = np.linalg.solve(np.linalg.cholesky(self.covariance), (x - self.mean).T)
        return np.exp(-np.square(off).sum(axis=0) / 2) / np.sqrt(np.linalg.det(self.covariance))


def is_rough(at: Linearization, covariance: np.ndarray, evaluate: Evaluate) -> bool:
    """Whether the error about an estimate, of this covariance (p, p) in the unit cube, is not the parabola that the
    sensitivities there say. False where initial states are not known, and for more parameters than sampling is good
    for.
    """
    if not 0 < len(at.x) <= SETTINGS.most_parameters or at.fitted_initial > SETTINGS.known:
        return False
    k = at.inflation
    sd = np.sqrt(np.maximum(np.diag(covariance), SETTINGS.smallest_sd**2))
    # row k: where the others are likeliest with parameter k so far off, `away` sd by the whole covariance
    ridges = SETTINGS.away * covariance / sd[:, None]
    moves = np.clip(at.x + np.concatenate([ridges, -ridges]), 0, 1) - at.x
    expected = -np.array([at.predicted_gain(dx, at.corrections, k) for dx in moves])
    rises = _objectives(at, at.x + moves, evaluate) - at.objectives(k).sum()
    apart = (rises < expected / SETTINGS.ratio) | (rises > SETTINGS.ratio * expected)
    return bool((apart & (np.maximum(np.abs(rises), expected) > k)).any())


def sampled_posterior(
    at: Linearization, covariance: np.ndarray, evaluate: Evaluate, seed: int
) -> SampledPosterior:
    """What simulations say of the parameters, the first of them about an estimate of this covariance (p, p)."""
    k = at.inflation
    generator = np.random.default_rng(seed)
    proposals: list[_Proposal] = []
    x, objectives = at.x[None], at.objectives(k).sum()[None]
    new = [
        _Proposal.about(at.x, scale**2 * covariance, SETTINGS.points // len(SETTINGS.scales))
        for scale in SETTINGS.scales
    ]
    for _ in range(SETTINGS.rounds):
        drawn = np.concatenate([p.draw(generator) for p in new])
        proposals += new
        x = np.concatenate([x, drawn])
        objectives = np.concatenate([objectives, _objectives(at, drawn, evaluate)])
        weights = _weights(x, (objectives - objectives.min()) / k, proposals)
        mean = weights @ x
        spread = np.einsum("n,np,nq->pq", weights, x - mean, x - mean)
        new = [_Proposal.about(mean, SETTINGS.wider**2 * spread, SETTINGS.points)]
    best = int(np.argmin(objectives))
    gain = float(objectives[0] - objectives[best]) / k
    return SampledPosterior(mean, spread, at.data.space.from_unit(x[best]), gain)


def _weights(x: np.ndarray, above: np.ndarray, proposals: list[_Proposal]) -> np.ndarray:
    """Of the points x (point, p), whose objectives over k are so much `above` the least; they add up to one."""
    drawn = sum(p.count * p.density(x) for p in proposals)
    heat = 1.0
    while True:
        log = -heat * above / 2 - np.log(np.maximum(drawn, np.finfo(float).tiny))
        weights = np.exp(log - log.max())
        weights /= weights.sum()
        if heat < SETTINGS.coldest or 1 / np.square(weights).sum() >= SETTINGS.enough:
            return weights
        heat *= SETTINGS.cooler


def _objectives(at: Linearization, x: np.ndarray, evaluate: Evaluate) -> np.ndarray:
    """(point,) at x (point, p), with initial states as they are; inf beyond the unit cube, and where one diverged."""
    inside = ((x >= 0) & (x <= 1)).all(axis=1)
    objectives = np.full(len(x), np.inf)
    if inside.any():
        corrections = np.repeat(at.corrections[None], int(inside.sum()), axis=0)
        outputs, diverged = evaluate(Trial(at.data.space.from_unit(x[inside]), corrections))
        objectives[inside] = trial_objectives(at.data, corrections, outputs, diverged, at.inflation).sum(
            axis=1
        )
    return objectives
