"""How long what is left of a log stays alike: autocovariance, autocorrelation time, and sums over blocks of it."""

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


def correlation_samples(residual: np.ndarray, mask: np.ndarray) -> float:
    """How many samples of a fit's residual (window, step, output) are worth one that is independent; 1: white.

    An autocorrelation time, in an output's own samples, averaged over outputs by their squares. What initial states and
    parameters could take is gone from the residual, so that over a window its autocovariance sums to nothing: the
    negative lags of a slow error cancel the positive ones. Summed are those before the first that is not positive: of a
    residual that oscillates that is more than its autocorrelation time, as its squares are correlated for longer.
    """
    return _correlation(residual, mask, np.ones(residual.shape[2]))


def correlation_steps(residual: np.ndarray, mask: np.ndarray) -> float:
    """Likewise in steps, of which a sparse output has a sample in few: those in which any output has one."""
    samples = mask.sum(axis=(0, 1))
    return _correlation(residual, mask, mask.any(axis=2).sum() / np.maximum(samples, 1))


def _correlation(residual: np.ndarray, mask: np.ndarray, apart: np.ndarray) -> float:
    """In a unit of which samples are so many `apart` (output,)."""
    covariance = autocovariance(residual, mask)
    return mean_time(np.array([_positive_sum(c) for c in covariance.T]) * apart, covariance, mask)


def _positive_sum(covariance: np.ndarray) -> float:
    ends = np.flatnonzero(covariance <= 0)
    positive = covariance[: ends[0]] if ends.size else covariance
    return float(2 * positive.sum() / covariance[0] - 1) if positive.size else 1.0


def block_squares(squares: np.ndarray, mask: np.ndarray, length: int) -> np.ndarray:
    """Sums of `squares` (window, step) over blocks of about `length` steps that do not cross windows, (block,).

    mask (window, step): the steps that have a sample. A window without any is no block.
    """
    sums = []
    for row, valid in zip(squares[mask.any(axis=1)], mask[mask.any(axis=1)], strict=True):
        used = row[valid]
        pieces = max(1, len(used) // max(length, 1))
        sums += [piece.sum() for piece in np.array_split(used, pieces)]
    return np.array(sums)
