"""Box-bounded nonlinear least squares through the simulator.

Gauss-Newton in the unit cube with a trust region (Nocedal & Wright, Numerical Optimization, 2nd ed., sections 10.3
and 4.1), the starts of all windows eliminated as nuisances. Every ask is one batch: all windows times all
finite-difference columns of all descents. Several descents begin at the best of a random screening.
"""

from __future__ import annotations

import mujoco
import numpy as np

from capture_cli.identifiers.base import Best, Evidence, Identifier, Trial
from capture_cli.identifiers.linearization import (
    Linearization,
    columns,
    objective,
    scaled_offsets,
)

SCREENED_PER_PARAMETER = 8
SCREENING_WINDOWS = 24  # evenly spread: enough to tell basins apart
RADIUS = 0.25  # of the unit cube, the first trust region
SHRINK = (1.0, 0.25, 0.0625, 0.015625)  # step lengths tried at once after a step that failed
CONVERGED_GAIN = 1e-4  # decrease of the objective over k: a hundredth of a standard error
CONVERGED_STEP = 1e-9  # of the unit cube
HOPELESS = 2.0  # a descent whose error stays this many times the best one's is given up
PATIENCE = 5  # rounds before it is


class LeastSquares(Identifier):
    """Least squares from `starts` places: the given start, then the best of a screening."""

    def __init__(self, evidence: Evidence, **options):
        super().__init__(evidence, **options)
        self._screening = self.starts > 1 and len(self.space) > 0
        self._descents = [] if self._screening else [Descent(evidence, self.space.to_unit(self.start))]
        self._asked: list[tuple[Descent, int]] = []

    @property
    def done(self) -> bool:
        return self.rounds_left <= 0 or (not self._screening and not self._active())

    @property
    def best(self) -> Best:
        if not self._descents:
            return Best(self.start, np.zeros_like(self.evidence.start_sd), np.inf)
        return min((d.best for d in self._descents), key=lambda b: b.error)

    def ask(self) -> Trial:
        if self._screening:
            points = self._screening_points()
            offsets = np.zeros((len(points), *self.evidence.start_sd.shape))
            return Trial(self.space.from_unit(points), offsets)
        trials = [d.ask() for d in self._active()]
        self._asked = [(d, len(t)) for d, t in zip(self._active(), trials, strict=True)]
        return Trial(
            np.concatenate([t.parameters for t in trials]), np.concatenate([t.offsets for t in trials])
        )

    def tell(self, outputs, diverged):
        if self._screening:
            self._begin(outputs, diverged)
            return
        first = 0
        for descent, size in self._asked:
            descent.tell(outputs[first : first + size], diverged[first : first + size])
            first += size
        self._drop_hopeless()

    def _active(self) -> list[Descent]:
        return [d for d in self._descents if not d.converged]

    def _screening_points(self) -> np.ndarray:
        """The start, then a Latin hypercube (candidate, parameter) in the unit cube."""
        size, count = len(self.space), SCREENED_PER_PARAMETER * len(self.space)
        generator = np.random.default_rng(self.seed)
        strata = np.stack([generator.permutation(count) for _ in range(size)], axis=1)
        points = (strata + generator.random((count, size))) / count
        return np.concatenate([self.space.to_unit(self.start)[None], points])

    def _begin(self, outputs, diverged) -> None:
        points = self._screening_points()
        error = np.square(self.evidence.residual(outputs)).sum(axis=(1, 2))
        error[diverged.any(axis=1)] = np.inf
        chosen = [0]
        for candidate in np.argsort(error, kind="stable"):
            apart = np.abs(points[candidate] - points[chosen]).max(axis=1).min()
            if len(chosen) < self.starts and apart > 0.1 and np.isfinite(error[candidate]):
                chosen.append(int(candidate))
        self._descents = [Descent(self.evidence, points[c]) for c in chosen]
        self._screening = False

    def _drop_hopeless(self) -> None:
        best = self.best
        for descent in self._active():
            beaten = descent.best.error > HOPELESS * best.error and descent.rounds >= PATIENCE
            close = np.abs(descent.x - self.space.to_unit(best.parameters)).max() < 1e-3
            if beaten or (close and descent.best.error > best.error):
                descent.converged = True


class Descent:
    """One Gauss-Newton descent in the unit cube, from x (parameter,)."""

    def __init__(self, evidence: Evidence, x: np.ndarray):
        self.evidence = evidence
        self.x = np.clip(x, 0.0, 1.0)
        self.offsets = np.zeros_like(evidence.start_sd)
        self.error = np.inf
        self.converged = False
        self.rounds = 0
        self._at: Linearization | None = None
        self._radius = RADIUS
        self._damping = 0.0
        self._trials: list[tuple[np.ndarray, np.ndarray]] = [(self.x, self.offsets)]

    @property
    def best(self) -> Best:
        return Best(self.evidence.space.from_unit(self.x), self.offsets, self.error)

    def ask(self) -> Trial:
        """One candidate with its finite differences; after a failure, several shorter steps without."""
        if len(self._trials) == 1:
            return columns(self.evidence, *self._trials[0])
        x, offsets = (np.stack(part) for part in zip(*self._trials, strict=True))
        return Trial(self.evidence.space.from_unit(x), offsets)

    def tell(self, outputs, diverged):
        self.rounds += 1
        if len(self._trials) == 1:
            self._tell_candidate(outputs, diverged)
        else:
            self._tell_shorter(outputs, diverged)

    def _tell_candidate(self, outputs, diverged) -> None:
        x, offsets = self._trials[0]
        there = Linearization.from_columns(self.evidence, x, offsets, outputs, diverged)
        lost = bool(diverged[0].any()) or not np.isfinite(there.residual).all()
        if self._at is None:
            if lost:
                self.converged = True
                return
        elif lost or there.objective(self._at.scatter) >= self._at.objective(self._at.scatter):
            self._propose_shorter()
            return
        self._accept(there)

    def _accept(self, there: Linearization) -> None:
        before = None if self._at is None else self._at.objective(there.scatter)
        self._at, self.x, self.offsets = there, there.x, there.offsets
        self.error = float(np.sqrt(np.square(there.residual).sum() / self.evidence.count))
        after = there.objective(there.scatter)
        if before is not None and before - after < CONVERGED_GAIN * there.scatter:
            self.converged = True
            return
        self._radius = min(2 * self._radius, 1.0) if before is not None else self._radius
        self._damping = self._damping / 10 if self._damping > 1e-3 else 0.0
        self._propose()

    def _propose(self) -> None:
        k = self._at.scatter
        dx = self._step(self._radius)
        offsets = self._at.start_offsets(dx, k, self._damping)
        if self._at.predicted_gain(dx, offsets, k) < CONVERGED_GAIN * k:
            self.converged = True
            return
        self._trials = [(np.clip(self.x + dx, 0, 1), offsets)]

    def _propose_shorter(self) -> None:
        """Shorter steps in both parameters and starts, tried at once."""
        k = self._at.scatter
        self._trials = []
        for factor in SHRINK:
            radius, damping = self._radius * factor / 4, self._damping + (1 / factor - 0.9) * k
            dx = self._step(radius, damping)
            self._trials.append((np.clip(self.x + dx, 0, 1), self._at.start_offsets(dx, k, damping)))
        if self._radius < CONVERGED_STEP:
            self.converged = True

    def _tell_shorter(self, outputs, diverged) -> None:
        k = self._at.scatter
        residuals = self.evidence.residual(outputs)
        z = [scaled_offsets(self.evidence, offsets) for _, offsets in self._trials]
        values = [np.inf if d.any() else objective(r, o, k) for r, o, d in zip(residuals, z, diverged, strict=True)]
        chosen = int(np.argmin(values))
        if not values[chosen] < self._at.objective(k):
            self._radius *= SHRINK[-1] / 4
            self._damping += k / SHRINK[-1]
            if self._radius < CONVERGED_STEP:
                self.converged = True
                return
            self._propose_shorter()
            return
        self._radius *= SHRINK[chosen] / 4
        self._damping += (1 / SHRINK[chosen] - 0.9) * k
        self._trials = [self._trials[chosen]]

    def _step(self, radius: float, damping: float | None = None) -> np.ndarray:
        """The Gauss-Newton step (parameter,) within the trust region and the unit cube."""
        damping = self._damping if damping is None else damping
        hessian, gradient = self._at.normal(self._at.scatter, damping)
        return box_step(hessian, gradient, np.maximum(-radius, -self.x), np.minimum(radius, 1 - self.x))


def box_step(hessian: np.ndarray, gradient: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Minimizes d'Hd/2 - g'd over low <= d <= high; directions without curvature are left alone."""
    size = len(gradient)
    if size == 0:
        return np.zeros(0)
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-12 * max(np.trace(hessian), 1e-300)))
    regular = hessian / np.outer(scale, scale) + 1e-9 * np.eye(size)
    step = np.zeros(size)
    factor = np.zeros((size, size + 7))
    rank = mujoco.mju_boxQP(step, factor, None, regular, -gradient / scale, low * scale, high * scale)
    return step / scale if rank >= 0 else np.clip(gradient / scale**2, low, high)
