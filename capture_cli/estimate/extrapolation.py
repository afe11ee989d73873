"""Where what was held out goes beyond all that was fitted: a model is known to hold only where it was fitted."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Beyond:
    """The output (its number) by which held-out windows leave the fitted range [low, high] as far as `reached`.

    share: of the squared error that was held out, that of the windows that leave it.
    """

    output: int
    low: float
    high: float
    reached: float
    share: float


def beyond_fitted(
    measured: np.ndarray, sampled: np.ndarray, residual: np.ndarray, is_test: np.ndarray
) -> Beyond | None:
    """How the windows `is_test` (window,) differ from the others, where that goes with their error.

    measured, sampled (window, step, output): of the whole log. residual (window, row): at what was fitted. Of the
    outputs that leave their fitted range where most of the error is, the one that leaves it by the most of that range;
    None where none does.
    """
    low, high = _ranges(measured, sampled)
    fitted = low[~is_test].min(axis=0), high[~is_test].max(axis=0)
    squares = np.square(residual[is_test]).sum(axis=1)
    found = [
        b for k in range(len(fitted[0])) if (b := _beyond(k, fitted, low[is_test], high[is_test], squares))
    ]
    return max(found, key=_excess, default=None)


def _ranges(measured: np.ndarray, sampled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest of each window's samples (window, step, output), (window, output); inf and -inf without any."""
    return tuple(
        reduce(np.where(sampled, measured, empty), axis=1)
        for reduce, empty in ((np.min, np.inf), (np.max, -np.inf))
    )


def _beyond(output: int, fitted, low: np.ndarray, high: np.ndarray, squares: np.ndarray) -> Beyond | None:
    """Of one output: fitted, low and high are (output,) and (window, output); squares (window,)."""
    least, most = (float(edge[output]) for edge in fitted)
    if least > most:
        return None  # it was never sampled where it was fitted
    below, above = least - low[:, output], high[:, output] - most
    beyond = 0.1  # of the range that was fitted: less is where any two parts of a log differ
    leaves = np.maximum(below, above) > beyond * (most - least)
    share = float(squares[leaves].sum() / squares.sum())
    mostly = 0.5  # of the squared error that was held out: with less something else differs as well
    if not share > mostly:  # nor is it where the simulation runs away and there is no error
        return None
    reached = low[:, output].min() if below.max() > above.max() else high[:, output].max()
    return Beyond(output, least, most, float(reached), share)


def _excess(beyond: Beyond) -> float:
    """How far it leaves the fitted range, over that range."""
    outside = max(beyond.low - beyond.reached, beyond.reached - beyond.high)
    return outside / max(beyond.high - beyond.low, np.finfo(float).tiny)
