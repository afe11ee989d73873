"""The curves of an estimate, made ready to draw: laid on one time axis, thinned, and summed up."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from capture_cli.stores.estimate import Estimate

# Past this the log's own clock (an epoch, say) makes unreadable tick labels: time is counted from the start.
LONGEST_CLOCK = 1e5
MAX_LAGS = 200


@dataclass(frozen=True)
class Curves:
    """An estimate's curves, window after window, with arrays of its own.

    x (step,): s, where each step is drawn; episodes stand one after the other.
    time (step,): s, the log's clock. measured, simulated, nominal (step, output): per output.
    slices: the steps of each window, in drawing order. number, episode, is_test (window,): of those windows;
        number counts them as the estimate does.
    """

    x: np.ndarray
    x_title: str
    time: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    nominal: np.ndarray
    slices: tuple[slice, ...]
    number: np.ndarray
    episode: np.ndarray
    is_test: np.ndarray

    @classmethod
    def of(cls, estimate: Estimate) -> Curves:
        a = estimate.arrays
        order = np.argsort(a["step/window"], kind="stable")
        time = a["step/time"][order]
        number, first = np.unique(a["step/window"][order], return_index=True)
        slices = tuple(slice(i, j) for i, j in zip(first, [*first[1:], len(order)], strict=True))
        episode = a["window/episode"][number]
        x, x_title = _lay_out(time, slices, episode)
        values = (a[f"step/{kind}"][order] for kind in ("measured", "simulated", "nominal"))
        return cls(x, x_title, time, *values, slices, number, episode, a["window/is_test"][number])

    @cached_property
    def residual(self) -> np.ndarray:
        """Measured minus simulated, (step, output)."""
        return self.measured - self.simulated

    @cached_property
    def step_is_test(self) -> np.ndarray:
        """(step,): True where the step's window was held out."""
        return np.repeat(self.is_test, [s.stop - s.start for s in self.slices])

    @cached_property
    def interval(self) -> float:
        """s, the median time between samples."""
        steps = np.concatenate([np.diff(self.time[s]) for s in self.slices])
        return float(np.median(steps)) if steps.size else 0.0

    def spans(self, mask: np.ndarray) -> list[tuple[float, float]]:
        """From where to where, on x, the windows of `mask` (window,) reach; neighbours are joined."""
        spans: list[list[float]] = []
        last = -2
        for w in np.flatnonzero(mask):
            begin, end = float(self.x[self.slices[w].start]), float(self.x[self.slices[w].stop - 1])
            if w == last + 1 and self.episode[w] == self.episode[last]:
                spans[-1][1] = end
            else:
                spans.append([begin, end])
            last = w
        return [(a, b) for a, b in spans]

    def episode_starts(self) -> list[float]:
        """Where, on x, each episode but the first begins."""
        begins = np.flatnonzero(np.diff(self.episode)) + 1
        return [float(self.x[self.slices[w].start]) for w in begins]

    def window_rms(self, scale: np.ndarray) -> np.ndarray:
        """RMS of the residual over `scale` (output,), per window, over all its outputs."""
        square = np.mean((self.residual / scale) ** 2, axis=1)
        return np.sqrt([square[s].mean() for s in self.slices])


def thin(
    values: np.ndarray, slices: tuple[slice, ...], points: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """About `points` of `values` (step, k) that draw the same curve, with a NaN row after every window.

    Returns the step each row is drawn at (row,), the rows (row, k), and the [first, last) rows of each window
    (window, 2). Where there are more steps than points, each stretch of a window gives its least and its
    greatest value, so that no peak is lost; the greater comes first where the stretch falls.
    """
    total = sum(s.stop - s.start for s in slices)
    if total <= points:
        at, rows, counts = _all_rows(values, slices)
    else:
        at, rows, counts = _extremes(values, slices, points / (2 * total))
    ends = np.cumsum(counts)
    at = np.insert(at, ends, at[ends - 1])
    rows = np.insert(rows, ends, np.nan, axis=0)
    stop = ends + np.arange(len(ends))
    return at, rows, np.stack([stop - counts, stop], axis=1)


def autocorrelation(residual: np.ndarray, slices: tuple[slice, ...]) -> np.ndarray:
    """Of one output's residual (step,), pooled over the windows: at lags 0, 1, … samples, (lag,).

    It reaches to half the median window and MAX_LAGS at most; not-finite steps count as the mean.
    """
    lags = int(min(MAX_LAGS, max(1, np.median([s.stop - s.start for s in slices]) // 2)))
    centred = np.nan_to_num(residual - np.nanmean(residual), posinf=0.0, neginf=0.0)
    total = np.zeros(lags + 1)
    for s in slices:
        n = s.stop - s.start
        spectrum = np.fft.rfft(centred[s], 2 * n)
        product = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[: min(n, lags + 1)]
        total[: len(product)] += product
    return total / total[0] if total[0] > 0 else np.eye(1, lags + 1)[0]


def bin_edges(residual: np.ndarray, floor: float | None, samples: int) -> np.ndarray:
    """Edges that show all but the farthest 0.2 % of a residual (step,), and three times the noise floor.

    samples: of the smallest histogram to be drawn with them; fewer samples make wider bins.
    """
    bins = int(np.clip(2 * samples ** (1 / 3), 15, 61))
    low, high = np.nanpercentile(residual, [0.1, 99.9])
    reach = max(abs(low), abs(high), 3 * (floor or 0.0)) or 1.0
    return np.linspace(-1.05 * reach, 1.05 * reach, bins + 1)


def _lay_out(time, slices, episode) -> tuple[np.ndarray, str]:
    if len(np.unique(episode)) == 1:
        if np.abs(time).max() <= LONGEST_CLOCK:
            return time, "time [s]"
        return time - time.min(), "time since the start [s]"
    x = np.empty_like(time)
    pause = 0.01 * sum(float(time[s][-1] - time[s][0]) for s in slices) / len(np.unique(episode))
    end = -pause
    for e in dict.fromkeys(episode.tolist()):
        members = [s for s, own in zip(slices, episode, strict=True) if own == e]
        begin = min(time[s][0] for s in members)
        for s in members:
            x[s] = time[s] - begin + end + pause
        end = max(x[s][-1] for s in members)
    return x, "time [s], one episode after the other"


def _all_rows(values, slices) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    at = np.concatenate([np.arange(s.start, s.stop) for s in slices])
    return at, values[at], np.array([s.stop - s.start for s in slices])


def _extremes(values, slices, stretches_per_step) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    counts = np.array([max(1, round((s.stop - s.start) * stretches_per_step)) for s in slices])
    edges = np.concatenate(
        [np.linspace(s.start, s.stop, n + 1)[:-1].astype(int) for s, n in zip(slices, counts, strict=True)]
    )
    last = np.append(edges[1:], slices[-1].stop)  # windows follow each other without a gap
    low, high = np.fmin.reduceat(values, edges), np.fmax.reduceat(values, edges)
    falls = values[last - 1] < values[edges]
    rows = np.empty((2 * len(edges), values.shape[1]))
    rows[0::2], rows[1::2] = np.where(falls, high, low), np.where(falls, low, high)
    at = np.stack([edges, (edges + last) // 2], axis=1).ravel()
    return at, rows, 2 * counts
