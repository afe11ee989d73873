"""Which windows of a log are fitted, which choose between models, and which are held out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_cli.estimate.prepared_log import PreparedLog

SELECT_SHARE = 3  # one window in three
ENOUGH_WINDOWS = 12  # to part with a third of them; fewer are cross-validated
BLOCK = 3  # windows in a row

FIT, SELECT, TEST = 0, 1, 2


@dataclass(frozen=True)
class LogParts:
    """number (window,): the part of each window, FIT, SELECT or TEST. folds: how the first two judge models."""

    prepared: PreparedLog
    folds: Folds
    number: np.ndarray

    @classmethod
    def of(cls, prepared: PreparedLog) -> LogParts:
        """What is held out stays so; the others are fitted, or choose where there are enough of them."""
        is_test = prepared.split.is_test
        folds = select_folds(prepared.windows.episode, is_test)
        return cls(prepared, folds, np.where(is_test, TEST, np.where(folds.fit, FIT, SELECT)))

    def windows(self, *parts: int) -> PreparedLog | None:
        """The windows of these parts alone; None where there is none."""
        keep = np.isin(self.number, parts)
        return self.prepared.part(keep) if keep.any() else None


@dataclass(frozen=True)
class Folds:
    """How effects are selected: `fit` (window,) is fitted; each of `folds` is (fitted, judged), (window,) both.

    With enough windows there is one fold, and what it judges is never fitted. With few, every window is judged by
    fits that did not see it.
    """

    fit: np.ndarray
    folds: tuple[tuple[np.ndarray, np.ndarray], ...]

    @property
    def seen(self) -> np.ndarray:
        """What is fitted or judges, (window,): all that is not test."""
        return np.any([self.fit, *(judged for _, judged in self.folds)], axis=0)


def select_folds(episode: np.ndarray, is_test: np.ndarray) -> Folds:
    """Folds of the windows that are not test; by whole episodes where there are enough, else by blocks in a row.

    Of few windows every third in turn: thirds in a row of a short log are driven too differently to judge each other.
    """
    rest = np.flatnonzero(~is_test)
    judged = np.zeros(len(episode), dtype=bool)
    episodes = np.unique(episode[rest])
    if len(rest) >= ENOUGH_WINDOWS:
        if len(episodes) >= 2 * SELECT_SHARE:
            judged = ~is_test & np.isin(episode, episodes[1::SELECT_SHARE])
        else:
            judged[rest[(np.arange(len(rest)) // BLOCK) % SELECT_SHARE == 1]] = True
        fit = ~is_test & ~judged
        return Folds(fit, ((fit, judged),))
    folds = []
    for number in range(min(SELECT_SHARE, len(rest)) if len(rest) > 1 else 0):
        judged = np.zeros(len(episode), dtype=bool)
        judged[rest[number::SELECT_SHARE]] = True
        folds.append((~is_test & ~judged, judged))
    return Folds(~is_test, tuple(folds))
