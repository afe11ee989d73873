"""Fit and select: which windows of the fitted ones choose among effects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SELECT_SHARE = 3  # one window in three
ENOUGH_WINDOWS = 12  # to part with a third of them; fewer are cross-validated
BLOCK = 3  # windows in a row


@dataclass(frozen=True)
class Folds:
    """How effects are selected: `fit` (window,) is fitted; each of `folds` is (fitted, judged), (window,) both.

    With enough windows there is one fold, and what it judges is never fitted. With few, every window is judged by
    fits that did not see it.
    """

    fit: np.ndarray
    folds: tuple[tuple[np.ndarray, np.ndarray], ...]


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
