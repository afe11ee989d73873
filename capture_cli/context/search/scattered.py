"""Scattered: every round at a distance of its own from the target, near or far, in no order. No search, but examples.

A posterior of the target must be right whoever asked the questions; so it is trained on questions of every kind rather
than on those of one search. Half of the parameters stay as they were in the round before: what an identifier has
learned nothing about, it does not move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_cli.context.search.base import Search


@dataclass(frozen=True)
class ScatteredSettings:
    kept: float = 0.5  # of the parameters, from one round to the next
    nearest: float = 1e-3  # of the range: beyond, simulated and measured are as good as equal
    scales: int = 64  # of the distance, equally spaced in its logarithm


SETTINGS = ScatteredSettings()


class Scattered(Search):
    summary = "any distance from the target in any round; for identifiers that ask questions of their own"

    def path(self, source, target, low, high, uniform):
        # each draw serves three times: to keep or to move, how far from the target, where within that distance
        moved, rest = (
            uniform >= SETTINGS.kept,
            (uniform - SETTINGS.kept) / (1 - SETTINGS.kept) * SETTINGS.scales,
        )
        reach = SETTINGS.nearest ** (np.floor(rest) / (SETTINGS.scales - 1)) * (high - low)
        lower, upper = (np.clip(target[:, None] + sign * reach, low, high) for sign in (-1, 1))
        places = lower + (rest - np.floor(rest)) * (upper - lower)
        path = [source]
        for move, place in zip(moved.swapaxes(0, 1), places.swapaxes(0, 1), strict=True):
            path.append(np.where(move, place, path[-1]))
        return np.stack(path, axis=1)
