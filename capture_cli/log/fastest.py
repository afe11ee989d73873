"""How fast a recorded coordinate went."""

from collections.abc import Sequence

import numpy as np

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    chance: float = 4.0  # sd that a difference of two samples may be larger by


def fastest(path: np.ndarray, time: np.ndarray, stretches: Sequence[slice], noise: float) -> float:
    """The largest mean speed, per s, over 1, 2, 4 and so on steps of a `path` (step,), less what noise may make of it.

    time (step,): s. stretches: of steps that belong together. noise: sd of the path. nan where it was not measured.
    """
    by_chance, speed = SETTINGS.chance * np.sqrt(2) * noise, 0.0
    for own in stretches:
        where, when = path[own], time[own]
        measured = np.isfinite(where)
        where, when = where[measured], when[measured]
        span = 1
        while span < len(where):
            moved = np.abs(where[span:] - where[:-span]) - by_chance
            speed = max(speed, float((moved / (when[span:] - when[:-span])).max()))
            span *= 2
    return speed
