"""A fitted model: a task with effects, the point where the search ended, and how outputs change about it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from capture_cli.common.evenly_spread import evenly_spread
from capture_cli.common.frozen import frozen
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.least_squares import SETTINGS as LEAST_SQUARES
from capture_cli.estimate.solve.linearization import Linearization
from capture_cli.model.effects.placed import Placed
from capture_cli.model.parameters import ParameterSpace


@frozen
class SETTINGS:
    # Evenly spread windows are scored on, at most so many; of many steps (hard contacts need short ones)
    # fewer: a score needs no more.
    scored_windows: int = 40
    scored_steps: int = 20_000
    fewest_scored: int = 12
    # of the objective over k: a third of a standard error is enough to compare models by
    tolerance: float = 0.1
    exact: float = 3e-3  # for what is reported
    as_good: float = 3.84  # of the objective over k: 95 % of what chance makes of one number


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model: its effects, space and point (parameter,), and its linearization on the part it was fitted to.

    finished: False where it was stopped early, behind a rival. promised: the error that its score test promises, where
    it was not fitted for promising too little.
    """

    effects: tuple[Placed, ...]
    space: ParameterSpace
    point: np.ndarray
    at: Linearization
    finished: bool = True
    promised: float | None = None

    def columns(self, name: str) -> slice:
        """Which of its parameters are those of the effect that is called `name`. Raises KeyError."""
        stop = len(self.space)
        for placed in reversed(self.effects):
            start = stop - len(placed.effect.parameters)
            if placed.name == name:
                return slice(start, stop)
            stop = start
        raise KeyError(name)

    @property
    def values(self) -> list[np.ndarray]:
        """Of the parameters of each of its effects, (parameter,)."""
        return [self.point[self.columns(e.name)] for e in self.effects]

    def known_from(self, first: np.ndarray) -> Self:
        """The fit, whose effects know no more than windows that begin at the steps `first` (window,) of the log say."""
        effects = [placed._replace(effect=placed.effect.fitted_to(first)) for placed in self.effects]
        return replace(self, effects=tuple(effects))

    def is_far_behind(self, rival: Self | None) -> bool:
        """Whether there is no hope of doing as well as `rival`."""
        return rival is not None and self.error > LEAST_SQUARES.hopeless * rival.error

    @property
    def corrections(self) -> np.ndarray:
        """Of the windows' initial states, (window, state), SI."""
        return self.at.corrections

    @cached_property
    def penalised_squares(self) -> float:
        """Sum of squared residuals, and what the hidden states of its effects took of it by chance alone.

        So that a model is not the better one for having a free number more in every window.
        """
        at = self.at
        share = at.taken_by_hidden.sum() / max(at.data.count - at.taken.sum(), 1.0)
        return float(np.square(at.residual).sum() * (1 + share))

    @property
    def error(self) -> float:
        """RMSE over the noise floor, over all outputs."""
        return float(np.sqrt(np.square(self.at.residual).sum() / self.at.data.count))

    @cached_property
    def excess(self) -> float:
        """Squared error above the noise floor, per sample, of the outputs that are above it: one whose floor is too
        high makes up for nothing in another.
        """
        data = self.at.data
        squares = np.square(self.at.residual.reshape(data.measured.shape)).sum(axis=(0, 1))
        above = np.maximum(squares - data.mask.sum(axis=(0, 1)), 0.0)
        return float(above.sum() / data.count)


def least(fits: Sequence[Fit | None]) -> Fit | None:
    """The fit with the least penalised squares, the first of those that have as little; None of none."""
    return min((f for f in fits if f is not None), key=lambda f: f.penalised_squares, default=None)


def thinned(part: PreparedLog, fit: Fit) -> tuple[PreparedLog, Linearization]:
    """As many windows of the part as a score needs, and the fit's linearization on them."""
    count = len(part.windows)
    affordable = SETTINGS.scored_steps / part.windows.grid_steps.mean()
    most = int(np.clip(affordable, SETTINGS.fewest_scored, SETTINGS.scored_windows))
    if count <= most:
        return part, fit.at
    keep = evenly_spread(count, most)
    few, at = part.part(keep), fit.at.windows(keep)
    rows = few.windows.measured.shape[1] * few.windows.measured.shape[2]  # its longest window may be gone
    return few, replace(
        at,
        data=replace(at.data, measured=few.windows.measured, mask=few.windows.sampled),
        residual=at.residual[:, :rows],
        by_parameter=at.by_parameter[:, :rows],
        by_initial=at.by_initial[:, :rows],
    )
