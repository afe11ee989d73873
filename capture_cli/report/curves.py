"""The curves of a record, made ready to draw: laid on one time axis, thinned, and summed up."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Self

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.quantities import scaled_unit
from capture_cli.store.diagnosis import Diagnosis
from capture_cli.store.estimate import Estimate


@frozen
class SETTINGS:
    # Past this the log's own clock (an epoch, say) makes unreadable tick labels: time is counted from the start.
    longest_clock: float = 1e5
    max_lags: int = 200


HELD_OUT = "held out"


@dataclass(frozen=True)
class Model:
    """One of the simulations that are drawn over the measurement, the first being what the record is about.

    title: in legends. color, residual_color: names in page.css; "" where the residual is not drawn.
    framed: whether axes make room for it; one that runs away must not hide the rest.
    """

    name: str
    title: str
    color: str
    residual_color: str = ""
    dash: str = "solid"
    width: float = 1.5
    framed: bool = True


OF_ESTIMATE = (
    Model("simulated", "simulated", "--simulated", "--residual"),
    Model("nominal", "nominal", "--nominal", dash="dot", width=1.2, framed=False),
)
OF_DIAGNOSIS = (
    Model("after", "with what was found", "--after", "--after"),
    Model("before", "declared", "--before", "--before", dash="dash", width=1.3),
)
NOTHING_FOUND = (Model("before", "declared", "--before", "--before"),)


@dataclass(frozen=True)
class Samples:
    """The residual of one output, window after window, in its own samples.

    residual, is_test (sample,): whether its window was held out. slices: those of each window that has some.
    interval: s, the median time between neighbours.
    """

    residual: np.ndarray
    is_test: np.ndarray
    slices: tuple[slice, ...]
    interval: float


@dataclass(frozen=True)
class Curves:
    """The curves of an estimate or a diagnosis, window after window, with arrays of its own.

    names, units, floors (output,): what outputs are called, and their noise floors in these units, None of one that has
    none.
    x (step,): s, where each step is drawn; episodes stand one after the other.
    time (step,): s, the log's clock. measured (step, output): NaN where an output has no sample.
    simulated: (step, output) of each of `models`, by name.
    slices: the steps of each window, in drawing order. number, episode, part (window,): of those windows; number
        counts them as the record does, part is a place in `parts`.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    floors: tuple[float | None, ...]
    x: np.ndarray
    x_title: str
    time: np.ndarray
    measured: np.ndarray
    models: tuple[Model, ...]
    simulated: dict[str, np.ndarray]
    slices: tuple[slice, ...]
    number: np.ndarray
    episode: np.ndarray
    parts: tuple[str, ...]
    part: np.ndarray

    @classmethod
    def of(cls, record: Estimate | Diagnosis) -> Self:
        a = record.arrays
        is_estimate = "window/is_test" in a
        models = OF_ESTIMATE
        if not is_estimate:
            models = OF_DIAGNOSIS if record.record.effects else NOTHING_FOUND
        parts = ("fitted", HELD_OUT) if is_estimate else ("fitted", "selecting", HELD_OUT)
        part = a["window/is_test"].astype(int) if is_estimate else a["window/part"]
        order = np.argsort(a["step/window"], kind="stable")
        time = a["step/time"][order]
        number, first = np.unique(a["step/window"][order], return_index=True)
        slices = tuple(slice(i, j) for i, j in zip(first, [*first[1:], len(order)], strict=True))
        episode = a["window/episode"][number]
        x, x_title = _lay_out(time, slices, episode)
        simulated = {m.name: a[f"step/{m.name}"][order] for m in models}
        names, units = (tuple(o[key] for o in record.attributes["outputs"]) for key in ("name", "unit"))
        return cls(
            names,
            units,
            tuple(record.record.noise_floor.get(name) for name in names),
            x,
            x_title,
            time,
            a["step/measured"][order],
            models,
            simulated,
            slices,
            number,
            episode,
            parts,
            part[number],
        )

    @cached_property
    def residual(self) -> np.ndarray:
        """Measured minus simulated by the model that the record is about, (step, output)."""
        return self.measured - self.simulated[self.models[0].name]

    @cached_property
    def residuals(self) -> dict[str, np.ndarray]:
        """That of every model whose residual is drawn, by name."""
        return {m.name: self.measured - self.simulated[m.name] for m in self.models if m.residual_color}

    def sampled(self, k: int) -> np.ndarray:
        """Where output k has a sample, (step,)."""
        return ~np.isnan(self.measured[:, k])

    def has_gaps(self, name: str, k: int) -> bool:
        """Whether a curve of output k, as the page calls it, has values at the output's samples alone.

        It is drawn as points: a line breaks wherever there is none.
        """
        if self.sampled(k).all():
            return False
        drawn = self.simulated.get(name)
        return drawn is None or bool(np.isnan(drawn[~self.sampled(k), k]).all())

    def scale(self, k: int) -> tuple[float, str]:
        """(factor, unit) in which output k is drawn."""
        return scaled_unit(self.units[k], float(np.nanmax(np.abs(self.measured[:, k]))))

    def residual_scale(self, k: int) -> tuple[float, str]:
        """(factor, unit) in which the residual of output k is drawn."""
        rms = max(float(np.sqrt(np.nanmean(r[:, k] ** 2))) for r in self.residuals.values())
        return scaled_unit(self.units[k], rms)

    def samples(self, k: int) -> Samples:
        """The residual of output k, at its samples alone."""
        own = self.sampled(k)
        ends = np.cumsum([0, *(int(own[s].sum()) for s in self.slices)]).tolist()
        slices = tuple(slice(a, b) for a, b in pairwise(ends) if a < b)
        time = self.time[own]
        steps = np.concatenate([np.diff(time[s]) for s in slices])
        interval = float(np.median(steps)) if steps.size else 0.0
        is_test = np.repeat(self.is_test, [s.stop - s.start for s in self.slices])
        return Samples(self.residual[own, k], is_test[own], slices, interval)

    @property
    def is_test(self) -> np.ndarray:
        """Which windows were held out, (window,)."""
        return self.part == self.parts.index(HELD_OUT)

    def windows_of(self, part: str) -> np.ndarray:
        """Which windows belong to a part, (window,); none where the record has no such part."""
        return self.part == self.parts.index(part) if part in self.parts else np.zeros(len(self.part), bool)

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
        """RMS of the residual over `scale` (output,), per window, over all its samples; 0 where it has none."""
        sampled = ~np.isnan(self.measured)
        square = np.where(sampled, np.square(self.residual / scale), 0.0)
        return np.sqrt([square[s].sum() / max(int(sampled[s].sum()), 1) for s in self.slices])


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
        at = np.concatenate([np.arange(s.start, s.stop) for s in slices])
        rows, counts = values[at], np.array([s.stop - s.start for s in slices])
    else:
        at, rows, counts = _extremes(values, slices, points / (2 * total))
    ends = np.cumsum(counts)
    at = np.insert(at, ends, at[ends - 1])
    rows = np.insert(rows, ends, np.nan, axis=0)
    stop = ends + np.arange(len(ends))
    return at, rows, np.stack([stop - counts, stop], axis=1)


def autocorrelation(residual: np.ndarray, slices: tuple[slice, ...]) -> np.ndarray:
    """Of one output's residual (step,), pooled over the windows: at lags 0, 1, … samples, (lag,).

    It reaches to half the median window and `max_lags` at most; not-finite steps count as the mean.
    """
    lags = int(min(SETTINGS.max_lags, max(1, np.median([s.stop - s.start for s in slices]) // 2)))
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
        if np.abs(time).max() <= SETTINGS.longest_clock:
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
