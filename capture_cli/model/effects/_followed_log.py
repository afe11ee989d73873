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


def steps_later(
    time: np.ndarray, stretches: Sequence[slice], first: np.ndarray, late: np.ndarray | float
) -> np.ndarray:
    """The steps of a log `late` s after its steps `first`, (simulation,) each, fractional; none beyond its stretch.

    time (step,): of the whole log, s.
    """
    at = first.astype(float)
    for steps in stretches:
        own = (first >= steps.start) & (first < steps.stop)
        if own.any() and steps.stop - steps.start > 1:
            interval = (time[steps.stop - 1] - time[steps.start]) / (steps.stop - 1 - steps.start)
            later = first + np.broadcast_to(late, first.shape) / interval
            at[own] = np.clip(later[own], steps.start, steps.stop - 1)
    return at


def at_steps(values: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """What `values` (step, ...) are at fractional steps (simulation,), straight between whole ones."""
    before = np.minimum(steps.astype(int), max(len(values) - 2, 0))
    share = (steps - before).reshape(-1, *[1] * (values.ndim - 1))
    return values[before] + share * (values[np.minimum(before + 1, len(values) - 1)] - values[before])


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


def without_gaps(time: np.ndarray, values: np.ndarray, stretches: Sequence[slice]) -> np.ndarray:
    """`values` (step,) of a log, straight between those that were measured, held beyond them; 0 where none was."""
    whole = np.zeros(len(values))
    for steps, within, measured in measured_stretches(time, values, stretches):
        whole[steps] = measured(within)
    return whole
