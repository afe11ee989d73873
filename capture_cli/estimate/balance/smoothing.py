"""Smoothing splines: a noisy series as a function of time that can be differentiated, its noise found by likelihood.

The series is y_i = z(t_i) + e_i, the prior of z is integrated white noise of the third order (the jerk is white): its
maximum a posteriori is the quintic spline that minimises

    sum_i (y_i - z(t_i))^2 / sd^2 + integral z'''(t)^2 dt / jerk

Both variances maximise the marginal likelihood of the series (Wahba 1985; Kohn & Ansley 1987). All matrices are banded,
so that the cost is linear in the number of samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array, vstack

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    """search: log10 of the smoothing parameter, in units of the sample interval^(2 `order`), from next to none to a
    parabola. at_once: sums that are filtered together: each reaches some knots, all reach many. far: by how many powers
    of e what is left out has fallen.
    """

    search: tuple[float, float] = (-3.0, 15.0)
    at_once: int = 50
    far: float = 20.0
    degree: int = 5
    order: int = 3  # of the derivative whose square is penalised; a polynomial below it costs nothing


FEWEST = 2 * SETTINGS.degree  # samples of a series that can be smoothed


@dataclass(frozen=True)
class Series:
    """One smoothed stretch of samples. `spline` is z(t); sd is of the samples, in their unit.

    basis (sample, knot); penalty: smoothness * integral of products of third derivatives, banded; factor: Cholesky's of
    basis' basis + penalty. cutoff: rad/s, where half of a sine is left of it.
    """

    time: np.ndarray
    basis: csr_array
    factor: np.ndarray
    penalty: np.ndarray
    knots: np.ndarray
    spline: BSpline
    sd: float
    cutoff: float

    def at(self, time: np.ndarray, derivative: int = 0) -> np.ndarray:
        """z or a derivative of it at `time` (point,), held at the ends of the series."""
        inside = np.clip(time, self.time[0], self.time[-1])
        return self.spline(inside, nu=derivative)

    def filtered(self, columns: np.ndarray, at: np.ndarray) -> np.ndarray:
        """What smoothing makes of series that are known at `at` (point,), evenly spread over the samples: `columns`
        (point, column), in its shape.

        A force that is compared with the smoothed acceleration has to go through the same filter.
        """
        basis, weight, factor = self._filter(at)
        return basis @ cho_solve_banded((factor, False), weight * (basis.T @ columns), check_finite=False)

    def filtering(self, rows: csr_array, at: np.ndarray, negligible: float = 1e-7) -> csr_array:
        """`rows` (row, point) of sums of series at `at`, with the filter before them: what is below a share of the
        largest weight is left out.
        """
        basis, weight, factor = self._filter(at)
        parts = [csr_array((0, len(at)))]
        for own in np.array_split(np.arange(rows.shape[0]), -(-rows.shape[0] // SETTINGS.at_once) or 1):
            right = csr_array(basis.T @ rows[own].T)
            here = self._reached(right)
            solved = cho_solve_banded((factor[:, here], False), right[here].toarray(), check_finite=False)
            points = np.flatnonzero(np.diff(basis[:, here].indptr))
            dense = weight * (basis[points][:, here] @ solved).T
            row, point = np.nonzero(np.abs(dense) >= negligible * np.abs(dense).max(initial=0.0))
            parts.append(csr_array((dense[row, point], (row, points[point])), shape=(len(own), len(at))))
        return csr_array(vstack(parts))

    def _filter(self, at: np.ndarray) -> tuple[csr_array, float, np.ndarray]:
        basis = _design(self.knots, at)
        weight = len(self.time) / len(at)
        return (
            basis,
            weight,
            cholesky_banded(weight * _banded(basis.T @ basis) + self.penalty, check_finite=False),
        )

    def response(self, rows: csr_array, at: np.ndarray, derivative: int) -> np.ndarray:
        """What the noise of each sample adds to sums `rows` (row, point) of a derivative at `at`, (row, sample): of the
        samples about the points of the rows alone, the same for every derivative.
        """
        own = np.unique(rows.indices)
        sums = _design(self.knots, at, derivative).T @ rows.T
        here = self._reached(csr_array(_design(self.knots, at[own]).T))
        solved = cho_solve_banded((self.factor[:, here], False), sums[here].toarray(), check_finite=False)
        samples = np.flatnonzero(np.diff(self.basis[:, here].indptr))
        return (self.basis[samples[0] : samples[-1] + 1, here] @ solved).T

    def _reached(self, right: csr_array) -> slice:
        """The coefficients in which a right side (knot, column) shows. What it adds falls by e within 2 / cutoff: the
        slowest root of the filter, s^6 = -cutoff^6, has half of that as its real part.
        """
        used = np.flatnonzero(np.diff(right.indptr))
        if not used.size:
            return slice(0, 0)
        interval = (self.time[-1] - self.time[0]) / (len(self.time) - 1)
        far = 4 * SETTINGS.degree + int(np.ceil(SETTINGS.far * 2 / (self.cutoff * interval)))
        return slice(max(int(used[0]) - far, 0), int(used[-1]) + far + 1)

    def sd_of(self, derivative: int) -> float:
        """Standard deviation of the derivative in the middle of the series, by the posterior of the spline."""
        middle = np.array([(self.time[0] + self.time[-1]) / 2])
        row = _design(self.knots, middle, derivative).toarray()[0]
        return self.sd * float(np.sqrt(row @ cho_solve_banded((self.factor, False), row)))


def smooth(
    times: Sequence[np.ndarray], values: Sequence[np.ndarray], fewest_turns: float = 0.0
) -> list[Series]:
    """The stretches of one channel, times[k] and values[k] (sample,), smoothed with one noise and one smoothness.

    fewest_turns: half turns of the slowest sine of which half is left, in a mean stretch, however smooth the series is.
    """
    parts = [_Part.of(t, y) for t, y in zip(times, values, strict=True)]
    turns = np.pi * fewest_turns * len(times) / sum(len(t) for t in times)  # rad per sample
    # of a stretch of few samples that many turns are beyond what its samples show: next to nothing is smoothed
    most = float(np.clip(-2 * SETTINGS.order * np.log10(max(turns, 1e-3)), *SETTINGS.search))
    bounds = SETTINGS.search[0], most
    found = minimize_scalar(
        lambda log: -_likelihood(parts, 10.0**log), bounds=bounds, method="bounded", options={"xatol": 0.05}
    )
    smoothness = 10.0**found.x
    sd = float(np.sqrt(_profiled_variance(parts, smoothness)))
    return [p.series(smoothness, sd) for p in parts]


@dataclass(frozen=True)
class _Part:
    """One stretch: its banded normal matrix and penalty (band, knot), and what the samples add to the right side."""

    time: np.ndarray
    values: np.ndarray
    knots: np.ndarray
    basis: csr_array
    gram: np.ndarray
    penalty: np.ndarray
    pull: np.ndarray
    unit: float  # what a smoothing parameter of 1 is, interval^(2 order - 1)

    @classmethod
    def of(cls, time: np.ndarray, values: np.ndarray) -> _Part:
        knots = _knots(time)
        basis = _design(knots, time)
        interval = (time[-1] - time[0]) / (len(time) - 1)
        return cls(
            time,
            values,
            knots,
            basis,
            _banded(basis.T @ basis),
            _banded(_penalty(knots)),
            basis.T @ values,
            interval ** (2 * SETTINGS.order - 1),
        )

    def solved(self, smoothness: float) -> tuple[np.ndarray, np.ndarray, float]:
        """The factor, coefficients (knot,) and the penalised sum of squares."""
        factor = cholesky_banded(self.gram + smoothness * self.unit * self.penalty, check_finite=False)
        found = cho_solve_banded((factor, False), self.pull, check_finite=False)
        return factor, found, float(self.values @ self.values - self.pull @ found)

    def series(self, smoothness: float, sd: float) -> Series:
        factor, found, _ = self.solved(smoothness)
        penalty = smoothness * self.unit * self.penalty
        cutoff = smoothness ** (-1 / (2 * SETTINGS.order)) / (self.unit ** (1 / (2 * SETTINGS.order - 1)))
        spline = BSpline(self.knots, found, SETTINGS.degree)
        return Series(self.time, self.basis, factor, penalty, self.knots, spline, sd, cutoff)


def _likelihood(parts: Sequence[_Part], smoothness: float) -> float:
    """Log of the marginal likelihood, the variance of the noise profiled out, up to a constant."""
    squares, log_determinant, count, knots = 0.0, 0.0, 0, 0
    for part in parts:
        factor, _, own = part.solved(smoothness)
        squares += own
        log_determinant += 2 * float(np.log(factor[-1]).sum())
        count += len(part.time) - SETTINGS.order
        knots += len(part.pull) - SETTINGS.order
    return -0.5 * (
        count * np.log(max(squares / count, 1e-300)) + log_determinant - knots * np.log(smoothness)
    )


def _profiled_variance(parts: Sequence[_Part], smoothness: float) -> float:
    count = sum(len(p.time) - SETTINGS.order for p in parts)
    return max(sum(p.solved(smoothness)[2] for p in parts) / count, 1e-300)


def _knots(time: np.ndarray) -> np.ndarray:
    """A knot at every sample but those next to the ends, so that there are as many coefficients as samples."""
    inner = time[SETTINGS.degree // 2 + 1 : -(SETTINGS.degree // 2 + 1)]
    return np.concatenate(
        [np.repeat(time[0], SETTINGS.degree + 1), inner, np.repeat(time[-1], SETTINGS.degree + 1)]
    )


def _design(knots: np.ndarray, time: np.ndarray, derivative: int = 0) -> csr_array:
    """Values at `time` (point,) of the basis or a derivative of it, (point, knot)."""
    inside = np.clip(time, knots[0], knots[-1])
    if not derivative:
        return csr_array(BSpline.design_matrix(inside, knots, SETTINGS.degree))
    return csr_array(
        BSpline.design_matrix(inside, knots[derivative:-derivative], SETTINGS.degree - derivative)
    ) @ (_differentiated(knots, derivative))


def _differentiated(knots: np.ndarray, derivative: int) -> csr_array:
    """What differentiation makes of coefficients, (knot - derivative, knot)."""
    count = len(knots) - SETTINGS.degree - 1
    matrix = csr_array(np.eye(1)) if count == 1 else None
    for order in range(derivative):
        degree, own = SETTINGS.degree - order, knots[order : len(knots) - order]
        size = count - order
        step = degree / (own[degree + 1 : degree + size] - own[1:size])
        rows = np.arange(size - 1)
        each = csr_array(
            (np.concatenate([-step, step]), (np.tile(rows, 2), np.concatenate([rows, rows + 1]))),
            shape=(size - 1, size),
        )
        matrix = each if matrix is None else each @ matrix
    return matrix


def _penalty(knots: np.ndarray) -> csr_array:
    """Integral of products of third derivatives of the basis, (knot, knot), by Gauss' rule, which is exact here."""
    ends = np.unique(knots)
    nodes, weights = np.polynomial.legendre.leggauss(SETTINGS.degree - SETTINGS.order + 1)
    half = np.diff(ends)[:, None] / 2
    points = (ends[:-1, None] + half * (1 + nodes)).ravel()
    third = _design(knots, points, SETTINGS.order)
    return third.T @ (third * (half * weights).ravel()[:, None])


def _banded(matrix: csr_array) -> np.ndarray:
    """The upper band (`degree` + 1, knot) of a symmetric matrix, as scipy's banded solvers take it."""
    size = matrix.shape[0]
    band = np.zeros((SETTINGS.degree + 1, size))
    for k in range(min(SETTINGS.degree + 1, size)):
        band[SETTINGS.degree - k, k:] = matrix.diagonal(k)
    return band
