"""Which windows of a log are fitted, which choose between models, and which are held out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_cli.common.evenly_spread import evenly_spread
from capture_cli.common.frozen import frozen
from capture_cli.estimate.balance.regression import SETTINGS as REGRESSION
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.log.windows import Windows


@frozen
class SETTINGS:
    judging: int = 3  # one block in so many judges
    block: int = 3  # windows in a row
    enough_windows: int = 12  # to part with some of them; fewer are cross-validated
    # Of a long log the search fits so many windows, evenly spread. A fit takes as long as the log is, and what doubles
    # the noise floor shows in these (benchmarks.planted). The model that is found is fitted to all.
    fitted: int = 36


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
        folds = select_folds(prepared.windows, is_test, prepared.left)
        return cls(prepared, folds, np.where(is_test, TEST, np.where(folds.balance, FIT, SELECT)))

    def windows(self, *parts: int) -> PreparedLog | None:
        """The windows of these parts alone; None where there is none."""
        keep = np.isin(self.number, parts)
        return self.prepared.part(keep) if keep.any() else None

    @property
    def fitted(self) -> PreparedLog:
        """What the search fits."""
        return self.prepared.part(self.folds.fit)


@dataclass(frozen=True)
class Folds:
    """How effects are selected: `fit` (window,) is fitted; each of `folds` is (fitted, judged), (window,) both.

    With enough windows there is one fold, and what it judges is never fitted. With few, every window is judged by
    fits that did not see it. balance (window,): of what the force balance is; of a long log a few of these are fitted.
    """

    fit: np.ndarray
    folds: tuple[tuple[np.ndarray, np.ndarray], ...]
    balance: np.ndarray

    @property
    def seen(self) -> np.ndarray:
        """What is fitted or judges, (window,)."""
        return np.any([self.fit, *(judged for _, judged in self.folds)], axis=0)


def select_folds(windows: Windows, is_test: np.ndarray, left: np.ndarray | None = None) -> Folds:
    """Folds of the windows that are not test (window,): every third block judges, of few windows each in turn.

    Recordings of an experiment go through its conditions in some order, and every third of them may be of one. So each
    recording has blocks that are fitted and blocks that judge. Those that are shorter than a block take turns in the
    order of how much moves in them, whatever the order of the log.

    left (window,): what the declared model leaves of each; then single windows take turns in the order of that.
    """
    rest = np.flatnonzero(~is_test)
    order, turn = _turns(windows.rows(rest)) if left is None else _ranked(left[rest])
    judged = np.zeros(len(windows), dtype=bool)
    if len(rest) >= SETTINGS.enough_windows:
        judged[rest[turn % SETTINGS.judging == 1]] = True
        others = ~is_test & ~judged
        fit = _thinned(others, SETTINGS.fitted)
        return Folds(fit, ((fit, judged),), others)
    folds = []
    for number in range(min(SETTINGS.judging, len(rest)) if len(rest) > 1 else 0):
        judged = np.zeros(len(windows), dtype=bool)
        judged[rest[order[number :: SETTINGS.judging]]] = True
        folds.append((~is_test & ~judged, judged))
    return Folds(~is_test, tuple(folds), ~is_test)


def _thinned(mask: np.ndarray, most: int) -> np.ndarray:
    """At most so many of the windows of a mask (window,)."""
    which = np.flatnonzero(mask)
    return np.isin(np.arange(len(mask)), which[evenly_spread(len(which), most)])


def _turns(windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """The windows (window,) by how much moves in their episodes, those of one in a row; and of each, (window,), how
    many blocks come before its own, of its episode, and episodes.
    """
    episode = np.unique(windows.episode, return_inverse=True)[1]
    moved = np.bincount(episode, weights=_motion(windows)) / np.bincount(episode)
    rank = np.argsort(np.argsort(moved, kind="stable"), kind="stable")[episode]
    order = np.lexsort((np.arange(len(rank)), rank))
    first = np.searchsorted(episode, episode)  # the windows of an episode are in a row
    return order, rank + (np.arange(len(rank)) - first) // SETTINGS.block


def _ranked(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The windows (window,) by their values, and how many come before each."""
    order = np.argsort(values, kind="stable")
    return order, np.argsort(order, kind="stable")


def _motion(windows: Windows) -> np.ndarray:
    """Variance of the outputs inside each window, (window,), in shares of that of all of them."""
    sampled = windows.sampled
    count = np.maximum(sampled.sum(axis=1), 1)
    mean = np.where(sampled, windows.measured, 0.0).sum(axis=1) / count
    squares = np.where(sampled, windows.measured - mean[:, None], 0.0) ** 2
    variance = squares.sum(axis=1) / count
    return (variance / np.maximum(variance.mean(axis=0), REGRESSION.tiny)).sum(axis=1)
