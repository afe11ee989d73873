"""How long what is left of a log stays alike: autocovariance and autocorrelation time of its outputs."""

from __future__ import annotations

import numpy as np


def own_samples(mask: np.ndarray) -> np.ndarray | None:
    """The steps of a `mask` (window, step, ...) in another order, of its shape: those of an output's own samples first,
    so that neighbours are neighbours. None where they are so already.
    """
    in_between = mask[:, 1:] & ~mask[:, :-1]
    return np.argsort(~mask, axis=1, kind="stable") if in_between.any() else None


def in_order(values: np.ndarray, order: np.ndarray | None) -> np.ndarray:
    """Values (window, step, ...) in the order (window, step, ...) of `own_samples`, which may have fewer axes."""
    if order is None:
        return values
    more = (1,) * (values.ndim - order.ndim)
    return np.take_along_axis(values, order.reshape(order.shape + more), axis=1)


def autocovariance(residual: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Pooled over windows, by lag and output (lag, output), of residual (window, step, output), mean 0 assumed.

    Lags are counted in an output's own samples, of which mask (window, step, output) says where they are.
    """
    order = own_samples(mask)
    residual, mask = in_order(residual * mask, order), in_order(mask, order)
    steps = residual.shape[1]
    size = 1 << (2 * steps - 1).bit_length()
    spectrum = np.fft.rfft(residual, size, axis=1)
    total = np.fft.irfft((np.abs(spectrum) ** 2).sum(axis=0), size, axis=0)[:steps]
    # every sample but the first `lag` of its window is the second of a pair
    pairs = mask.sum(axis=0)[::-1].cumsum(axis=0)[::-1]
    return total / np.maximum(pairs, 1)


def mean_time(times: np.ndarray, covariance: np.ndarray, mask: np.ndarray) -> float:
    """Times (output,) averaged by the squares of a residual with this autocovariance (lag, output); 1 of none."""
    samples = mask.sum(axis=(0, 1))
    squares = covariance[0] * (samples / max(int(samples.max(initial=0)), 1))
    total = squares.sum()
    return float((times * squares).sum() / total) if total > 0 else 1.0


def correlation_length(covariance: np.ndarray) -> tuple[int, float]:
    """Lags to keep and the autocorrelation time 1 + 2 sum(rho), in samples, of one output's autocovariance (lag,).

    Self-consistent window: the first lag that is 5 times the time so far (Sokal 1997, section 3).
    """
    if covariance[0] <= 0:
        return 0, 1.0
    times = 2 * np.cumsum(covariance / covariance[0]) - 1
    beyond = np.flatnonzero(np.arange(len(times)) >= 5 * np.maximum(times, 0.2))
    lag = int(beyond[0]) if beyond.size else len(times) - 1
    return lag, max(float(times[lag]), 1.0)


def autocorrelation_time(residual: np.ndarray, mask: np.ndarray) -> float:
    """In an output's own samples, averaged over outputs by their squares; residual (window, step, output). 1: white."""
    covariance = autocovariance(residual, mask)
    return mean_time(np.array([correlation_length(c)[1] for c in covariance.T]), covariance, mask)
