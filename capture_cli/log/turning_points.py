"""Turning points of a measured path: the history that forces with memory depend on."""

from collections.abc import Sequence

import numpy as np

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    remembered: int = 16  # ways between turning points, the last ones


class WaysBefore:
    """`ways_before` of one path, each step of the log worked out once."""

    def __init__(self, path: np.ndarray, episodes: Sequence[slice], least: float):
        self.path, self.episodes, self.least = path, episodes, least
        self._known: dict[int, np.ndarray] = {}

    def __call__(self, steps: np.ndarray) -> np.ndarray:
        """(len(steps), `remembered`)."""
        each, row = np.unique(steps, return_inverse=True)
        new = np.array([s for s in each if s not in self._known], dtype=int)
        if len(new):
            ways = ways_before(self.path, self.episodes, new, self.least)
            self._known.update(zip(new.tolist(), ways, strict=True))
        return np.array([self._known[s] for s in each])[row]


def ways_before(path: np.ndarray, episodes: Sequence[slice], steps: np.ndarray, least: float) -> np.ndarray:
    """How far a path went from turning point to turning point, (len(steps), `remembered`), the last way up to each of
    `steps`; 0 before the first.

    path (step,): nan where it was not measured. It has turned where it went back by more than `least`.
    """
    ways = np.zeros((len(steps), SETTINGS.remembered))
    for episode in episodes:
        inside = np.flatnonzero((steps >= episode.start) & (steps < episode.stop))
        turned: list[float] = []
        way, begin = 0.0, episode.start
        for row in inside[np.argsort(steps[inside], kind="stable")]:
            since = path[begin : steps[row] + 1]
            for value in since[np.isfinite(since)].tolist():
                way = _go_on(turned, value, way, least)
            begin = steps[row] + 1
            last = np.diff([*turned[-SETTINGS.remembered :], turned[-1] + way]) if turned else []
            ways[row, SETTINGS.remembered - len(last) :] = last
    return ways


def _go_on(turned: list[float], value: float, way: float, least: float) -> float:
    """The way from the last of the points that have `turned`, to which one is added where `value` has gone back."""
    if not turned:
        turned.append(value)
        return 0.0
    farthest = turned[-1] + way
    if way == 0.0:
        return value - turned[-1] if abs(value - turned[-1]) > least else 0.0
    if (value - farthest) * way > 0:
        return value - turned[-1]
    if abs(value - farthest) > least:
        turned.append(farthest)
        return value - farthest
    return way
