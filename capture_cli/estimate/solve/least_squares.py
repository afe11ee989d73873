"""Box-bounded nonlinear least squares through the simulator.

Every ask is one batch: all windows times all finite-difference columns of all descents. Several descents begin at the
best of a random screening.
"""

from dataclasses import dataclass

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.solve._descent import Descent
from capture_cli.estimate.solve.base import Best, Identifier
from capture_cli.estimate.solve.linearization import Data, Known, Linearization, Trial


@frozen
class SETTINGS:
    screened_per_parameter: int = 8
    converged_gain: float = 3e-3  # decrease of the objective over k: a twentieth of a standard error
    hopeless: float = 2.0  # a descent whose error stays this many times the best known is stopped early
    patience: int = 5  # rounds before it is, where it does not even promise better
    long_patience: int = 15  # and where it does


@dataclass(frozen=True)
class EarlyStop:
    """When a descent is stopped early: where it stays far above `to_beat`, an error that is known to be possible, for
    `patience` rounds; and where it does not promise to get to `needed`, an error above which the answer is of no use.
    """

    to_beat: float = np.inf
    patience: int = SETTINGS.patience
    needed: float = np.inf


class LeastSquares(Identifier):
    """Least squares from `starts` places: the given start, then the best of a screening.

    The screening is no round of its own. tolerance: a descent is done when its objective over k falls by less.
    measured: whether sensitivities are to be measured where it ends. known: sensitivities near the start that need not
    be measured, if there are any.
    """

    summary = "Gauss-Newton from several places through the simulator"

    def __init__(
        self,
        data: Data,
        *,
        tolerance: float = SETTINGS.converged_gain,
        early_stop: EarlyStop = EarlyStop(),
        measured: bool = True,
        known: Known | None = None,
        **options,
    ):
        super().__init__(data, **options)
        self.tolerance = tolerance
        self.early_stop = early_stop
        self.measured = measured
        self.known = known
        self._screening = self.starts > 1 and len(self.space) > 0
        self._descents = [] if self._screening else [self._descent(self.space.to_unit(self.start))]
        self._asked: list[tuple[Descent, int]] = []
        self._of_few = False

    @property
    def at_rest(self) -> bool:
        return not self._screening and not self._active()

    @property
    def best(self) -> Best:
        if not self._descents:
            return Best(self.start, self.corrections, np.inf)
        return self._leader.best

    @property
    def at(self) -> Linearization | None:
        return self._leader.at if self._descents else None

    @property
    def stopped_early(self) -> bool:
        """Whether the best was left where it was, behind what is known to be possible."""
        return bool(self._descents) and self._leader.stopped_early

    @property
    def _leader(self) -> Descent:
        return min(self._descents, key=lambda d: d.error)

    def ask(self) -> Trial:
        if self._screening:
            points = self._screening_points()
            corrections = np.repeat(self.corrections[None], len(points), axis=0)
            return Trial(self.space.from_unit(points), corrections)
        trials = [d.ask() for d in self._active()]
        self._asked = [(d, len(t)) for d, t in zip(self._active(), trials, strict=True)]
        self._of_few = all(t.windows is not None for t in trials)
        if len(trials) == 1:
            return trials[0]
        return Trial(
            np.concatenate([t.parameters for t in trials]), np.concatenate([t.corrections for t in trials])
        )

    def tell(self, outputs, diverged, exact: bool = True):
        if self._screening:
            self._begin(outputs, diverged)
            self.rounds_left += 1  # a search of one round is to end somewhere
            return
        self.rounds_left += self._of_few  # for these a round of few windows is none
        first = 0
        for descent, size in self._asked:
            descent.tell(outputs[first : first + size], diverged[first : first + size], exact)
            first += size
        self._drop_hopeless()

    def _descent(self, x: np.ndarray) -> Descent:
        known = None if self._screening else self.known
        return Descent(self.data, x, self.corrections, self.tolerance, known, measured=self.measured)

    def _active(self) -> list[Descent]:
        return [d for d in self._descents if not d.converged]

    def _screening_points(self) -> np.ndarray:
        """The start, the nominal values, and a Latin hypercube, (candidate, parameter) in the unit cube."""
        size, count = len(self.space), SETTINGS.screened_per_parameter * len(self.space)
        generator = np.random.default_rng(self.seed)
        strata = np.stack([generator.permutation(count) for _ in range(size)], axis=1)
        points = (strata + generator.random((count, size))) / count
        known = [self.space.to_unit(self.start), self.space.to_unit(self.space.nominal)]
        return np.concatenate([known, points])

    def _begin(self, outputs, diverged) -> None:
        points = self._screening_points()
        residual = self.data.residual(outputs)
        error = np.square(residual, out=residual).sum(axis=(1, 2))
        error[diverged.any(axis=1)] = np.inf
        chosen = [0]
        for candidate in np.argsort(error, kind="stable"):
            apart = np.abs(points[candidate] - points[chosen]).max(axis=1).min()
            if len(chosen) < self.starts and apart > 0.1 and np.isfinite(error[candidate]):
                chosen.append(int(candidate))
        self._descents = [self._descent(points[c]) for c in chosen]
        self._screening = False

    def _drop_hopeless(self) -> None:
        best = self.best
        possible = min(best.error, self.early_stop.to_beat)
        for descent in self._active():
            beaten = (
                descent.rounds >= self.early_stop.patience and descent.expected > SETTINGS.hopeless * possible
            )
            beaten |= (
                descent.rounds >= SETTINGS.long_patience and descent.error > SETTINGS.hopeless * possible
            )
            beaten |= not descent.would_reach(possible, self.rounds_left)
            beaten |= descent.falls_short_of(self.early_stop.needed)
            descent.stopped_early |= beaten
            close = np.abs(descent.x - self.space.to_unit(best.parameters)).max(initial=0.0) < 1e-3
            if beaten or (close and descent.best.error > best.error):
                descent.converged = True
