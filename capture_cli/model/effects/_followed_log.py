"""What a log did before each of its steps: followed through every stretch of it, straight where it was not measured."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np


def since_stretches_began(time: np.ndarray, stretches: Sequence[slice]) -> np.ndarray:
    """s, at each step of a log since the one of its `stretches` began that the step is of, (step,); 0 outside of them.

    time (step,): of the whole log.
    """
    since = np.zeros(len(time))
    for steps in stretches:
        since[steps] = time[steps] - time[steps.start]
    return since


def measured_stretches(
    time: np.ndarray, values: np.ndarray, stretches: Sequence[slice]
) -> Iterator[tuple[slice, np.ndarray, Callable[[np.ndarray], np.ndarray]]]:
    """Each of the `stretches` of a log in which something was measured: its steps, their times (step,), s, and a
    function that gives the values at any times (n,), straight between samples and held beyond them.

    time, values (step,): of the whole log; values are nan where they were not measured.
    """
    for steps in stretches:
        measured = np.isfinite(values[steps])
        if measured.any():
            within = time[steps]
            yield steps, within, partial(np.interp, xp=within[measured], fp=values[steps][measured])
