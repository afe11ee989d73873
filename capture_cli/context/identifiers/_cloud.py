"""The posterior of a pair whose rounds are noisy, by regression over a cloud of simulated points.

Where a sensor's noise grows with the value, what lies near zero says most, and a descent that weighs it so stops in
sharp minima of its own making. Simulations all over what is still possible do not: a linear regression of the outputs
over the cloud, the covariance of what it leaves taken for noise beside the sensor's, is a Gaussian posterior that
is as sure as the cloud is linear (posterior linearisation: García-Fernández, Svensson, Morelande and Särkkä 2015). New
points are drawn from that posterior, widened, and take the place of those farthest from it: the cloud closes in as
the rounds allow, and what has been simulated serves again.

The sensor's noise has a standard deviation sqrt(a^2 + b^2 y^2) where the output is y, a and b for each feature.

Parameters are in the unit cube, outputs over the features' scales.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.solve.linearization import box_step


@frozen
class SETTINGS:
    # Of a feature's scale: what is taken for noise at least, for a simulation is not smooth below
    roughness: float = 2e-4
    # Points of a cloud, for each coefficient of the regression; one of them new in each round
    per_coefficient: int = 7
    wider: float = 1.5  # times the posterior's standard deviation, a cloud's
    farthest: float = 2.5  # standard deviations of the distribution that points are drawn from
    # times the standard deviation of what is known at first, and of the range at most
    first: tuple[float, float] = 3.0, 0.2
    reach: float = 3.0  # standard deviations of the cloud, in one regression
    smallest_sd: float = 1e-4  # of the range, of new points
    # of the variance that the regression leaves, for its coefficients are uncertain, too
    more_noise: float = 0.5
    law_steps: int = 4  # of the fit in turns of parameters and noise
    # values of a and of b that are tried at once, and how often a finer grid follows
    grid: int = 9
    finer: int = 4
    # of an output, its noise b
    least_share: float = 1e-3
    most_share: float = 2.0


# (pair, rounds, x (p,)), ... -> what each would show, (round, d)
Outputs = Callable[[list[tuple[int, list[int], np.ndarray]]], list[np.ndarray]]


@dataclass
class Cloud:
    """mean (p,), covariance (p, p): the posterior. points (n, p), outputs (n, round, d): what was simulated."""

    mean: np.ndarray
    covariance: np.ndarray
    points: np.ndarray
    outputs: np.ndarray

    @classmethod
    def about(cls, mean: np.ndarray, covariance: np.ndarray, d: int) -> Self:
        """Points well spread about what is known at first, not simulated yet; d values a round."""
        wider, most = SETTINGS.first
        values, vectors = np.linalg.eigh(covariance)
        covariance = (vectors * np.minimum(wider**2 * values, most**2)) @ vectors.T
        cloud = cls(mean, covariance, np.zeros((0, len(mean))), np.zeros((0, 0, d)))
        cloud.points = cloud.drawn(SETTINGS.per_coefficient * (len(mean) + 1))
        cloud.outputs = np.zeros((len(cloud.points), 0, d))
        return cloud

    @property
    def rounds(self) -> int:
        """How many the points were simulated in."""
        return self.outputs.shape[1]

    def drawn(self, count: int) -> np.ndarray:
        """New points (count, p) from the posterior, widened; others after every round."""
        size = len(self.mean)
        generator = np.random.default_rng(self.rounds)
        factor = np.linalg.cholesky(
            SETTINGS.wider**2 * self.covariance + SETTINGS.smallest_sd**2 * np.eye(size)
        )
        off = np.clip(generator.standard_normal((count, size)), -SETTINGS.farthest, SETTINGS.farthest)
        return np.clip(self.mean + off @ factor.T, 0, 1)

    def learn(self, outputs: np.ndarray) -> None:
        """What the points show in further rounds, (n, round, d)."""
        self.outputs = np.concatenate([self.outputs, outputs], axis=1)

    def take(self, points: np.ndarray, outputs: np.ndarray) -> None:
        """New points (m, p) with their outputs (m, round, d), for as many that are farthest from the posterior."""
        count = len(self.points)
        every = np.concatenate([self.points, points])
        off = every - self.mean
        distance = np.einsum("np,pq,nq->n", off, np.linalg.inv(self.covariance), off)
        kept = np.sort(np.argsort(distance, kind="stable")[:count])
        self.points = every[kept]
        self.outputs = np.concatenate([self.outputs, outputs])[kept]

    def fit(self, measured: np.ndarray, features: int) -> None:
        """The posterior given measured rounds (round, d), d being points of `features` each.

        Beforehand parameters are anywhere in the cube. A transformer's answer is no part of it: it is made of the same
        rounds, and does not know of their noise.
        """
        size = len(self.mean)
        middle, j, left_over = self._regression()
        residual = measured.ravel() - middle
        spread = self.points.std(axis=0)
        low = np.maximum(-self.mean, -SETTINGS.reach * spread)
        high = np.minimum(1 - self.mean, SETTINGS.reach * spread)
        unexplained = np.square(left_over).sum(axis=0)
        flat = 12 * np.eye(size)  # the precision of a uniform distribution
        squares = np.square(residual) * residual.size / max(1, residual.size - size)
        for _ in range(SETTINGS.law_steps):
            noise = _noise(squares, np.square(middle), unexplained, features)
            weighted = _weighted(j, noise + SETTINGS.more_noise * unexplained, left_over)
            hessian = j.T @ weighted + flat
            step = box_step(hessian, weighted.T @ residual + flat @ (0.5 - self.mean), low, high)
            covariance = np.linalg.inv(hessian)
            # expected squares of the noise, the step being uncertain (expectation maximisation)
            squares = np.square(residual - j @ step) + np.einsum("np,pq,nq->n", j, covariance, j)
        self.mean, self.covariance = np.clip(self.mean + step, 0, 1), covariance

    def _regression(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Outputs at the mean (round * d,), slopes (round * d, p), and what is left of each point (n, round * d), such
        that its products are a covariance.
        """
        design = np.column_stack([np.ones(len(self.points)), self.points - self.mean])
        flat = self.outputs.reshape(len(self.points), -1)
        coefficients = np.linalg.lstsq(design, flat, rcond=None)[0]
        left = (flat - design @ coefficients) / np.sqrt(len(flat) - design.shape[1])
        return coefficients[0], coefficients[1:].T, left


def improve(
    clouds: dict[int, Cloud], measured: dict[int, np.ndarray], outputs: Outputs, features: int
) -> None:
    """Fit the clouds of some pairs to what was measured of them (round, d), of which they know but the first rounds.

    The new rounds are simulated at all points, then all rounds at new points: two batches.
    """
    new = {k: list(range(cloud.rounds, len(measured[k]))) for k, cloud in clouds.items()}
    for k, shown in _simulated({k: cloud.points for k, cloud in clouds.items()}, new, outputs).items():
        clouds[k].learn(shown)
        clouds[k].fit(measured[k], features)
    drawn = {k: cloud.drawn(len(cloud.mean) + 1) for k, cloud in clouds.items()}
    every = {k: list(range(cloud.rounds)) for k, cloud in clouds.items()}
    for k, shown in _simulated(drawn, every, outputs).items():
        clouds[k].take(drawn[k], shown)
        clouds[k].fit(measured[k], features)


def _simulated(points: dict[int, np.ndarray], rounds: dict[int, list[int]], outputs: Outputs) -> dict:
    """Outputs (n, round, d) of each pair's points (n, p) in its rounds; in one batch."""
    results = iter(outputs([(k, rounds[k], x) for k in points for x in points[k]]))
    return {k: np.stack([next(results) for _ in points[k]]) for k in points}


def _weighted(j: np.ndarray, noise: np.ndarray, left_over: np.ndarray) -> np.ndarray:
    """Slopes j (d, p) times the inverse of diag(noise (d,)) + left_over' left_over, of (n, d) (Woodbury)."""
    scaled = left_over / noise
    inner = np.eye(len(left_over)) + scaled @ left_over.T
    return j / noise[:, None] - scaled.T @ np.linalg.solve(inner, scaled @ j)


def _noise(squares: np.ndarray, outputs: np.ndarray, known: np.ndarray, features: int) -> np.ndarray:
    """Variance of the sensor's noise (d,), from squares of residuals (d,), of outputs (d,), and variances (d,) that
    have other causes; values of the `features` in turn.
    """
    noise = np.empty_like(squares)
    for feature in range(features):
        at = slice(feature, None, features)
        noise[at] = _law(squares[at], outputs[at], known[at])
    return noise


def _law(squares: np.ndarray, outputs: np.ndarray, known: np.ndarray) -> np.ndarray:
    """a^2 + b^2 * outputs (d,), as maximum likelihood has a and b, by ever finer grids."""
    floor = np.log(SETTINGS.roughness)
    log_a = np.linspace(floor, max(np.log(4 * squares.mean()) / 2, floor + 1), SETTINGS.grid)
    log_b = np.linspace(np.log(SETTINGS.least_share), np.log(SETTINGS.most_share), SETTINGS.grid)
    for _ in range(SETTINGS.finer):
        variance = np.exp(2 * log_a)[:, None, None] + np.exp(2 * log_b)[:, None] * outputs + known
        unlikely = (np.log(variance) + squares / variance).sum(axis=-1)
        a, b = np.unravel_index(np.argmin(unlikely), unlikely.shape)
        best_a, best_b = log_a[a], log_b[b]
        step_a, step_b = log_a[1] - log_a[0], log_b[1] - log_b[0]
        log_a = np.maximum(np.linspace(best_a - step_a, best_a + step_a, SETTINGS.grid), floor)
        log_b = np.linspace(best_b - step_b, best_b + step_b, SETTINGS.grid)
    return np.exp(2 * best_a) + np.exp(2 * best_b) * outputs
