"""Rows of a regression from accelerations at points: averaged over short times, and their noise made white.

The smoothed acceleration carries the noise e of the positions through a known filter, and the prediction carries it
through the model's own stiffness and damping: with F the averaging and S the smoothing a row's noise is
F (D^2 + d D + k) S e. Its covariance is worked out once for a long stretch and taken as stationary. What no sensor's
noise explains is taken as white acceleration, and as noise of the sensors that is forgotten within some samples (of
cameras, filters, interpolation), each of a size that maximises the likelihood of the residual. White rows are compared
as squares: that is generalised least squares, and over a segment nearly what simulating it would compare.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import LinAlgError, cholesky, eigh, solve_triangular, toeplitz
from scipy.linalg.lapack import dpotrf, dtrtrs
from scipy.optimize import minimize, minimize_scalar
from scipy.sparse import csr_array

from capture_cli.common.recursive_filter import recursively_filtered
from capture_cli.errors import LogError
from capture_cli.estimate.balance.force_balance import ForceBalance
from capture_cli.estimate.balance.forward_dynamics import Accelerations


@dataclass(frozen=True)
class WhiteningSettings:
    """rows_in_segment: whose noise is whitened together; more let slow errors of the model weigh like a free run of the
    whole segment. most_rows: of one coordinate over the whole log, which bounds the cost. degree: of the averaging
    functions, smooth enough that no row sees single samples. floor: of the covariance's diagonal, for rounding.
    segments: at least so many, that there are blocks to leave out; fewest_rows: in each of these, or the log is too
    short to be judged. memories: samples within which slow noise may be forgotten.
    slow_gain: of log likelihood, by which there has to be some.
    """

    rows_in_segment: int = 120
    most_rows: int = 2500
    degree: int = 3
    floor: float = 1e-9
    segments: int = 6
    fewest_rows: int = 6
    reach: float = 1.0
    memories: tuple[float, ...] = (4.0, 16.0)
    slow_gain: float = 5.0


SETTINGS = WhiteningSettings()


@dataclass(frozen=True)
class Segment:
    """Rows whose noise is whitened together: of a span of time in a stretch, and one of the coordinates."""

    span: int
    part: int
    coordinate: int
    rows: slice

    def __len__(self) -> int:
        return self.rows.stop - self.rows.start


class Whitening:
    """How accelerations along a balance become white rows, of the coordinates that sensors show, `dofs`.

    model_error (coordinate,): sd of the white acceleration that the model leaves at rows' rate, and slow_noise (memory,
    coordinate): sd of noise with each memory over that of white noise; both set by `adapt`. Raises LogError where the
    log is too short for blocks to be left out.
    """

    def __init__(self, balance: ForceBalance, settings: WhiteningSettings = SETTINGS):
        self.balance, self.settings = balance, settings
        smoothed, points = balance.smoothed, balance.points
        self.dofs = smoothed.dofs
        cutoff = max(s[0].cutoff for s in smoothed.series.values())
        spacing = max(np.pi / cutoff, 2 * points.interval, len(points) * points.interval / settings.most_rows)
        self.averages = [
            self._averages(points.since[points.part == n], spacing) for n in range(len(smoothed.parts))
        ]
        self.spacing = spacing
        total = sum(a.shape[0] for a in self.averages)
        if total < settings.segments * settings.fewest_rows:
            raise LogError(
                f"the log has {total} independent accelerations of each joint, and "
                f"{settings.segments * settings.fewest_rows} are needed to judge effects by blocks that are left out",
                cure="record longer, or faster motion",
            )
        self.size = min(settings.rows_in_segment, total // settings.segments)
        filters = smoothed.filtering(self.averages, points.part, points.step)
        self._filters = [[own[i] for i in self.dofs] for own in filters]
        rows, self._responses = self._noise_of_rows()
        self.white = _autocovariance(rows[:, np.unique(rows.indices)].toarray(), self.size)
        self.noise, self.slow = self._noise_covariances()
        self.spans = [
            (n, slice(int(rows[0]), int(rows[-1]) + 1))
            for n, averages in enumerate(self.averages)
            if averages.shape[0]
            for rows in np.array_split(np.arange(averages.shape[0]), -(-averages.shape[0] // self.size))
        ]
        self._reach = settings.reach / cutoff
        self.segments = self._segments()
        self._diagonals: dict[tuple, tuple[np.ndarray, np.ndarray, float]] = {}
        self.reset()

    def reset(self) -> None:
        """Take it that nothing but the sensors' white noise is left."""
        self.model_error = np.zeros(len(self.dofs))
        self.slow_noise = np.zeros((len(self.settings.memories), len(self.dofs)))
        self._factorise()

    def rows(self, columns: Sequence[Accelerations]) -> list[np.ndarray]:
        """What each of `columns` adds to the rows, (row, nv, column) of each stretch, not yet white."""
        points = self.balance.points
        if not columns:
            return [np.zeros((a.shape[0], len(self.dofs), 0)) for a in self.averages]
        predicted = np.stack([c.predicted[:, self.dofs] for c in columns], axis=-1)
        moved = [k for k, c in enumerate(columns) if c.measured.any()]
        found = []
        for n, (averages, filters) in enumerate(zip(self.averages, self._filters, strict=True)):
            own = points.part == n
            rows = -np.stack([f @ predicted[own, i] for i, f in enumerate(filters)], axis=1)
            for k in moved:
                rows[..., k] += averages @ columns[k].measured[own][:, self.dofs]
            found.append(rows)
        return found

    def whitened(self, rows: Sequence[np.ndarray]) -> list[np.ndarray]:
        """White rows (row, column) of each segment."""
        found = []
        for own in self.segments:
            some = rows[own.part][own.rows, own.coordinate]
            found.append(self._factors[own.coordinate][: len(some), : len(some)] @ some)
        return found

    def blocks(self, most: int) -> np.ndarray:
        """Which block each segment is of, (segment,), no more than `most`: blocks are whole stretches or, of few
        stretches, some spans in a row.
        """
        parts = np.unique([n for n, _ in self.spans], return_inverse=True)[1]
        several = parts.max() + 1 >= most // 2
        units = (parts if several else np.arange(len(parts)))[[s.span for s in self.segments]]
        units = np.unique(units, return_inverse=True)[1]
        count = int(units.max()) + 1
        return units * min(count, most) // count

    def block_of_row(self, blocks: np.ndarray) -> np.ndarray:
        """The block that each white row is of, (row,), from those of segments."""
        return np.repeat(blocks, [len(s) for s in self.segments])

    def log_determinants(self) -> np.ndarray:
        """Of what makes the rows of each segment white, (segment,): the log likelihood of rows is this less half of
        their white squares.
        """
        logs = [np.cumsum(np.log(np.diag(f))) for f in self._factors]
        return np.array([logs[s.coordinate][len(s) - 1] for s in self.segments])

    def adapt(self, residual: Sequence[np.ndarray], slow_noise: np.ndarray) -> None:
        """Set `model_error` to what makes `residual` (row, nv) of each stretch most likely, with `slow_noise` (memory,
        nv) as it was found, or none. A coordinate without segments is left as it is.
        """
        for i, own in enumerate(self._by_length(residual)):
            if own:
                self.model_error[i], self.slow_noise[:, i] = self._most_likely(i, own, slow_noise[:, i])
        self._factorise()

    @property
    def beyond_noise(self) -> float:
        """The variance of rows that the sensors' white noise does not explain, over that which it does: of the
        coordinate where that is most.
        """
        noise = np.array([lags[0] for lags in self.noise])
        slow = [sizes**2 @ lags[:, 0] for sizes, lags in zip(self.slow_noise.T, self.slow, strict=True)]
        return float(((np.square(self.model_error) * self.white[0] + slow) / noise).max())

    def slow_noise_of(self, residual: Sequence[np.ndarray]) -> np.ndarray:
        """Sizes of slow noise, (memory, nv), in `residual` (row, nv) of each stretch: of each coordinate one at most,
        where it surely is.
        """
        return np.stack([self._slow_noise(i, own) for i, own in enumerate(self._by_length(residual))], axis=1)

    def _by_length(self, residual: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
        """Of each coordinate the segments of each length, (row, segment)."""
        found = []
        for i in range(len(self.model_error)):
            own = [residual[s.part][s.rows, i] for s in self.segments if s.coordinate == i]
            lengths = sorted({len(r) for r in own})
            found.append([np.stack([r for r in own if len(r) == count], axis=1) for count in lengths])
        return found

    def _most_likely(
        self, dof: int, residual: Sequence[np.ndarray], slow_noise: np.ndarray
    ) -> tuple[float, np.ndarray]:
        """Sizes of white acceleration and of slow noise, (memory,), which is as it was found or none."""
        choices = {tuple(s): s for s in (np.zeros(len(slow_noise)), slow_noise)}
        found = []
        for number, sizes in enumerate(choices.values()):
            surprise, error = self._error(dof, sizes, residual)
            found.append((surprise + number * self.settings.slow_gain, error, sizes))
        _, error, sizes = min(found, key=lambda f: f[0])
        return error, sizes

    def _error(self, dof: int, slow_noise: np.ndarray, residual: Sequence[np.ndarray]) -> tuple[float, float]:
        """The size of white acceleration that is most likely beside the sensors' noise, and minus the log likelihood.

        Where both covariances are diagonal: of C = N + e^2 W, with W v = l N v and v' N v = 1, the determinant is that
        of N times the product of 1 + e^2 l, and r' C^-1 r is the sum of (v' r)^2 / (1 + e^2 l).
        """
        terms = []
        for own in residual:
            values, vectors, log_determinant = self._diagonal(dof, tuple(slow_noise), len(own))
            squares = np.square(vectors.T @ own).sum(axis=1)
            terms.append((values, squares, own.shape[1], log_determinant))

        def surprise(size: float) -> float:
            total = 0.0
            for values, squares, count, log_determinant in terms:
                larger = 1 + 10.0 ** (2 * size) * values
                total += 0.5 * float((squares / larger).sum())
                total += 0.5 * count * (log_determinant + float(np.log(larger).sum()))
            return total

        scale = self._scale(dof)
        found = minimize_scalar(
            surprise, bounds=(scale - 3, scale + 4), method="bounded", options={"xatol": 0.05}
        )
        return float(found.fun), 10.0**found.x

    def _diagonal(
        self, dof: int, slow_noise: tuple[float, ...], count: int
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Of `count` rows: l (row,), v (row, row) in columns, and the logarithm of the determinant of N."""
        key = dof, slow_noise, count
        if key not in self._diagonals:
            noise = self._covariance(dof, 0.0, np.array(slow_noise))[:count, :count]
            values, vectors = eigh(toeplitz(self.white[:count]), noise)
            determinant = 2 * np.log(np.diag(cholesky(noise, lower=True))).sum()
            self._diagonals[key] = np.maximum(values, 0.0), vectors, float(determinant)
        return self._diagonals[key]

    def _slow_noise(self, dof: int, residual: Sequence[np.ndarray]) -> np.ndarray:
        """Sizes of slow noise of one coordinate, (memory,)."""
        scale, none = self._scale(dof), np.zeros(len(self.slow_noise))
        best, error = self._error(dof, none, residual)
        sizes, found = np.log10(error) - scale, none

        def surprise(size: np.ndarray, memory: np.ndarray) -> float:
            covariance = self._covariance(dof, 10.0 ** (scale + size[0]), memory * 10.0 ** size[1])
            return _surprise(covariance, residual)

        for own in np.eye(len(none)):
            more = minimize(
                surprise,
                [sizes, 0.0],
                args=(own,),
                method="Nelder-Mead",
                bounds=[(-3, 4), (-2, 2)],
                options={
                    "xatol": 0.05,
                    "fatol": 0.5,
                    "initial_simplex": [[sizes, 0], [sizes - 1, 0.3], [sizes - 1, 0.6]],
                },
            )
            if more.fun < best - self.settings.slow_gain:
                best, found = more.fun, own * 10.0 ** more.x[1]
        return found

    def _scale(self, dof: int) -> float:
        """Logarithm of the white acceleration that is as large as the sensors' white noise."""
        return float(np.log10(np.sqrt(self.noise[dof][0] / self.white[0])))

    def _segments(self) -> list[Segment]:
        """The rows of each span in which a coordinate moves, no nearer than `_reach`, s, to where it rests: its
        acceleration jumps where it comes to rest or breaks away, and smoothing spreads the jump. Nor to where nobody
        knows how it moves.
        """
        found, points = [], self.balance.points
        moves = []
        for n, averages in enumerate(self.averages):
            own = points.part == n
            time = points.since[own]
            rests = self.balance.at_rest[own][:, self.dofs] | self.balance.unknown[own, None]
            ends = [time[averages.indices[a:b]][[0, -1]] for a, b in pairwise(averages.indptr)]
            low, high = np.array(ends).reshape(-1, 2).T
            counts = np.cumsum(np.vstack([np.zeros(len(self.dofs), dtype=int), rests]), axis=0)
            until, since = np.searchsorted(time, high + self._reach), np.searchsorted(time, low - self._reach)
            moves.append(counts[until] == counts[since])
        for number, (n, rows) in enumerate(self.spans):
            for i in range(len(self.dofs)):
                edges = np.flatnonzero(np.diff(np.concatenate([[0], moves[n][rows, i], [0]]).astype(int)))
                for a, b in zip(edges[::2], edges[1::2], strict=True):
                    found.append(Segment(number, n, i, slice(rows.start + int(a), rows.start + int(b))))
        if not found:
            raise LogError("no joint moves for long enough in the log", cure="record longer motion")
        return found

    def _averages(self, elapsed: np.ndarray, spacing: float) -> csr_array:
        """Weights (row, point) of overlapping splines, whole ones only: they sum to 1."""
        degree = self.settings.degree
        count = int(elapsed[-1] / spacing) if len(elapsed) else 0
        if count < 2 * degree:
            return csr_array((0, len(elapsed)))
        knots = np.arange(-degree, count + degree + 1) * spacing
        inside = np.flatnonzero(elapsed < count * spacing)
        weights = csr_array(BSpline.design_matrix(elapsed[inside], knots, degree).T)[degree:-degree]
        weights = csr_array(weights / weights.sum(axis=1)[:, None])
        whole = csr_array((weights.data, inside[weights.indices], weights.indptr))
        whole.resize(weights.shape[0], len(elapsed))
        return whole

    def along(self, balance: ForceBalance) -> Whitening:
        """The same in another balance of the same log, as if the model had the same slopes there."""
        moved = copy(self)
        moved.balance = balance
        moved.model_error, moved.slow_noise = self.model_error.copy(), self.slow_noise.copy()
        return moved

    def at(self, balance: ForceBalance) -> Whitening:
        """The same in another balance of the same log, where the model has other slopes."""
        moved = self.along(balance)
        moved.noise, moved.slow = moved._noise_covariances()
        moved._diagonals = {}
        moved.reset()
        return moved

    def about(self, balance: ForceBalance) -> Whitening:
        """Likewise, where other stretches rest, too."""
        moved = self.at(balance)
        moved.segments = moved._segments()
        return moved

    def _noise_of_rows(self) -> tuple[csr_array, list[tuple[int, np.ndarray]]]:
        """Rows in the middle of the longest stretch, (row, point), and of each coordinate what the noise of samples
        adds to their positions, velocities and accelerations, (derivative, row, sample).
        """
        balance = self.balance
        longest = int(np.argmax([a.shape[0] for a in self.averages]))
        middle = self.averages[longest].shape[0] // 2
        some = self.averages[longest][max(0, middle - self.size) : middle + self.size]
        time = balance.smoothed.log.time[balance.points.step[balance.points.part == longest]]
        found = []
        for source in balance.smoothed.sources:
            for dof in source.dofs:
                number = int(np.searchsorted(self.dofs, dof))
                for column, weight in zip(source.columns, source.shares(dof), strict=True):
                    series = balance.smoothed.series[column][longest]
                    responses = [series.response(some, time, derivative) for derivative in range(3)]
                    found.append((number, weight * series.sd * np.array(responses)))
        return some, found

    def _noise_covariances(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Autocovariance of rows by sensors' white noise of each coordinate, (lag,), and by as much of slow noise,
        (memory, lag).
        """
        size, memories = self.size, self.settings.memories
        stiffness, damping = (slopes[self.dofs] for slopes in self.balance.slopes())
        noise = [np.zeros(size) for _ in self.dofs]
        slow = [np.zeros((len(memories), size)) for _ in self.dofs]
        for dof, (position, velocity, acceleration) in self._responses:
            response = acceleration - damping[dof] * velocity - stiffness[dof] * position
            noise[dof] += _autocovariance(response, size)
            slow[dof] += [_autocovariance(_remembering(response, m), size) for m in memories]
        return noise, slow

    def _covariance(self, dof: int, model_error: float, slow_noise: np.ndarray) -> np.ndarray:
        lags = self.noise[dof] + model_error**2 * self.white + slow_noise**2 @ self.slow[dof]
        matrix = lags[self._apart]
        matrix.flat[:: len(lags) + 1] *= 1 + self.settings.floor
        return matrix

    @cached_property
    def _apart(self) -> np.ndarray:
        """How far apart rows are, (row, row)."""
        rows = np.arange(self.size)
        return np.abs(rows[:, None] - rows)

    def _factorise(self) -> None:
        sizes = zip(self.model_error, self.slow_noise.T, strict=True)
        whole = [cholesky(self._covariance(i, e, s), lower=True) for i, (e, s) in enumerate(sizes)]
        self._factors = [solve_triangular(f, np.eye(len(f)), lower=True) for f in whole]


def _autocovariance(response: np.ndarray, size: int) -> np.ndarray:
    """Over lags (size,) of rows (row, noise) to independent noise. Sums over rows are divided by all of them, so that
    no frequency has a negative power.
    """
    covariance = response @ response.T
    count = len(covariance)
    lags = np.zeros(size)
    lags[:count] = [np.trace(covariance, offset=k) / count for k in range(min(size, count))]
    return lags


def _remembering(response: np.ndarray, memory: float) -> np.ndarray:
    """The response of rows (row, sample) to what makes noise of the same sd that is forgotten within `memory` samples:
    e[k] = exp(-1 / memory) e[k - 1] + white noise.
    """
    kept = np.exp(-1 / memory)
    driven = np.sqrt(1 - kept**2) * response.T[::-1]
    return np.ascontiguousarray(recursively_filtered((1.0,), (-kept,), driven).T)[:, ::-1]


def _surprise(covariance: np.ndarray, residual: Sequence[np.ndarray]) -> float:
    """Minus the log likelihood of segments, (row, segment) of each length, up to a constant."""
    factor, wrong = dpotrf(covariance, lower=True, clean=True)
    if wrong:
        raise LinAlgError("the covariance is not positive definite")
    logs = np.cumsum(np.log(np.diag(factor)))
    total = 0.0
    for own in residual:
        white, _ = dtrtrs(factor[: len(own), : len(own)], own, lower=True)
        total += 0.5 * float((white * white).sum()) + logs[len(own) - 1] * own.shape[1]
    return total
