"""Where and when does the residual arise? Its acceleration against time, position, velocity, input and contacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

BINS = 24
HALF_WIDTH = 8  # samples on either side of the local quadratic that differentiates the residual


@dataclass(frozen=True)
class Curve:
    """Mean residual acceleration in bins of a covariate.

    centre, mean, error (bin,), the last bin repeated where the covariate has fewer values; share: of the residual
    acceleration's variance that the covariate accounts for (correlation ratio, less what as many random bins would).
    """

    centre: np.ndarray
    mean: np.ndarray
    error: np.ndarray
    share: float


def accelerations(residual: np.ndarray, time: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Second derivative of residual (window, step, output) by local quadratics; NaN where there is no room.

    time (window, step): s, evenly spaced or not.
    """
    out = np.full(residual.shape, np.nan)
    width = 2 * HALF_WIDTH + 1
    if residual.shape[1] < width:
        return out
    views = np.lib.stride_tricks.sliding_window_view
    window, step = np.nonzero(views(mask, width, axis=1).all(axis=-1))
    near = views(time, width, axis=1)[window, step] - time[window, step + HALF_WIDTH, None]
    basis = near[..., None] ** np.arange(3) / near[:, -1, None, None] ** np.arange(3)
    gram = np.swapaxes(basis, 1, 2) @ basis
    weights = 2 * np.linalg.solve(gram, np.swapaxes(basis, 1, 2))[:, 2] / np.square(near[:, -1:])
    around = views(residual, width, axis=1)[window, step]  # (place, output, sample)
    out[window, step + HALF_WIDTH] = np.einsum("pos,ps->po", around, weights)
    return out


def largest_around(values: np.ndarray) -> np.ndarray:
    """The largest of `values` (window, step) within the samples that an acceleration is taken over."""
    from scipy.ndimage import maximum_filter1d

    return maximum_filter1d(values, 2 * HALF_WIDTH + 1, axis=1, mode="nearest")


def curve(covariate: np.ndarray, acceleration: np.ndarray) -> Curve:
    """Bins of equal count of `covariate` (step,), both flat and of one output; NaN are left out.

    A covariate of few values, such as a number of contacts, has a bin for each.
    """
    good = np.isfinite(acceleration) & np.isfinite(covariate)
    x, y = covariate[good], acceleration[good]
    empty = np.full(BINS, np.nan)
    if len(x) < 4 * BINS or np.ptp(x) == 0:
        return Curve(empty, empty, empty, 0.0)
    values = np.unique(x)
    if len(values) <= BINS:
        groups = [np.flatnonzero(x == value) for value in values]
    else:
        groups = np.array_split(np.argsort(x, kind="stable"), BINS)
    mean = _means(y, groups)
    error = np.array([y[g].std() / np.sqrt(len(g)) for g in groups])
    total = np.square(y - y.mean()).sum()
    between = sum(len(g) * (y[g].mean() - y.mean()) ** 2 for g in groups)
    share = 1 - (1 - between / total) * (len(y) - 1) / (len(y) - len(groups)) if total > 0 else 0.0
    curves = (np.pad(c, (0, BINS - len(groups)), mode="edge") for c in (_means(x, groups), mean, error))
    return Curve(*curves, float(max(share, 0.0)))


def _means(values: np.ndarray, groups: list[np.ndarray]) -> np.ndarray:
    return np.array([values[g].mean() for g in groups])
