"""Scattered: every round at a distance of its own from the target, near or far, in no order. No search, but examples.

A posterior of the target must be right whoever asked the questions; so it is trained on questions of every kind rather
than on those of one search. Half of the parameters stay as they were in the round before: what an identifier has
learned nothing about, it does not move.
"""

import numpy as np

from capture_cli.context.search.base import Search


class Scattered(Search):
    summary = "any distance from the target in any round; for identifiers that ask questions of their own"

    def path(self, source, target, low, high, uniform):
        # each draw serves three times: to keep or to move, how far from the target, where within that distance
        kept = 0.5  # of the parameters, from one round to the next
        scales = 64  # of the distance, equally spaced in its logarithm
        moved, rest = (uniform >= kept, (uniform - kept) / (1 - kept) * scales)
        nearest = 1e-3  # of the range: beyond, simulated and measured are as good as equal
        reach = nearest ** (np.floor(rest) / (scales - 1)) * (high - low)
        lower, upper = (np.clip(target[:, None] + sign * reach, low, high) for sign in (-1, 1))
        places = lower + (rest - np.floor(rest)) * (upper - lower)
        path = [source]
        for move, place in zip(moved.swapaxes(0, 1), places.swapaxes(0, 1), strict=True):
            path.append(np.where(move, place, path[-1]))
        return np.stack(path, axis=1)
