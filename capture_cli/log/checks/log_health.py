"""The health of a measured log in numbers, however damaged it is: timing per episode, values per channel."""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.log.quantisation import distinct, grid_step
from capture_cli.log.windows import SETTINGS as WINDOWS


@frozen
class SETTINGS:
    places_listed: int = 5
    neighbours: int = 3  # values next to an extreme
    at_rest: float = 0.01  # of an input's largest value: less is rest
    band_edges: tuple[float, ...] = (0.0, 0.001, 0.01, 0.1, 1.0)  # of the Nyquist frequency
    least_spectrum: int = 16  # samples
    # in an episode: of fewer nobody can tell whether they are one frequency or several
    fewest_periods: int = 6
    # Of the power within two lines of the strongest: one frequency and little else. Of the changes, and of
    # the signal, as changes grow with the frequency, and a slow sine hardly shows in them.
    single_line: float = 0.9
    single_signal: float = 0.98
    spike: float = 20.0  # times what samples usually are off the line between their neighbours
    # of a spike, at most, is what its neighbours are off the line that leaves it out
    spike_alone: float = 0.1
    # Of samples at either end of an episode, where nothing shows that the curve goes on without it: times
    # what the others are off the line through the next two at most, and times the step between these, as a
    # body that bounces goes back twice that at most
    spike_at_end: float = 3.0
    bounce: float = 2.5
    fewest_beside_end: int = 20  # samples that the end of an episode is compared with


def timing(time: np.ndarray, usual: float | None = None) -> dict[str, Any]:
    """Timing of one episode from its times (step,), s, however they jump.

    usual: the interval, s, by which gaps are judged where the steps are those of several sensors, each at a rate of its
    own; the intervals' median where None.
    Intervals are from the latest time so far; those that do not go forward, and gaps, are left out of
    the statistics: rate in Hz; jitter_sd and jitter_max, of the interval over its median; None of several sensors.
    """
    with np.errstate(invalid="ignore"):
        time = np.where(np.isfinite(time), time, np.nan)
        interval = np.diff(time)
        ahead = time[1:] - np.fmax.accumulate(time)[:-1]
        median = float(np.median(ahead[ahead > 0])) if np.any(ahead > 0) else np.inf
        median = median if usual is None else usual
        forward = ahead[(ahead > 0) & (ahead <= WINDOWS.gap_factor * median)]
        gaps = np.flatnonzero(ahead > WINDOWS.gap_factor * median)
        repeated, backward = np.flatnonzero(interval == 0), np.flatnonzero(interval < 0)
    finite = time[np.isfinite(time)]
    even = forward.size and usual is None
    return {
        "steps": len(time),
        "start": float(finite[0]) if finite.size else None,
        "duration": float(np.ptp(finite)) if finite.size else None,
        "interval": _number(median),
        "rate": 1 / median if even else None,
        "jitter_sd": float(forward.std() / median) if even else None,
        "jitter_max": float(forward.max() / median) if even else None,
        "gaps": _places(gaps, time, ahead),
        "repeated_times": _places(repeated, time, interval),
        "backward_times": _places(backward, time, interval),
    }


def channel(values: np.ndarray, episodes: Sequence[slice]) -> dict[str, Any]:
    """Range and faults of one channel (step,).

    levels: how many different values. low, high: the least and the greatest value, the share of the samples
    exactly there, in how many visits, and the mean share at each of the next few values (neighbours).
    constant_episodes: those in which the channel never changes.
    """
    finite = values[np.isfinite(values)]
    levels, counts = np.unique(finite, return_counts=True)
    with np.errstate(invalid="ignore"):
        still = [i for i, e in enumerate(episodes) if e.stop - e.start > 1 and np.ptp(values[e]) == 0]
    bad = np.flatnonzero(~np.isfinite(values))
    return {
        "mean": _number(finite.mean()) if finite.size else None,
        "rms": _number(np.sqrt(np.mean(np.square(finite)))) if finite.size else None,
        "low": _extreme(values, levels[0], counts[1:]) if finite.size else None,
        "high": _extreme(values, levels[-1], counts[-2::-1]) if finite.size else None,
        "levels": len(levels),
        "nan": int(np.isnan(values).sum()),
        "infinite": int(np.isinf(values).sum()),
        "bad_steps": bad[: SETTINGS.places_listed].tolist(),
        "constant": len(levels) == 1,
        "constant_episodes": still,
    }


def sampling(time: np.ndarray, episodes: Sequence[slice]) -> dict[str, Any]:
    """Of a sparse output with samples at `time` (sample,): how many, the fewest in an episode, and their rate, Hz."""
    rates = [t["rate"] for t in (timing(time[e]) for e in episodes) if t["rate"] is not None]
    return {
        "samples": len(time),
        "fewest": min((e.stop - e.start for e in episodes), default=0),
        "rate": float(np.median(rates)) if rates else None,
    }


def quantisation(values: np.ndarray) -> dict[str, float | None]:
    """step: of the grid that an output (step,) sits on, None where on none; change: median, per sample."""
    finite = values[np.isfinite(values)]
    change = np.abs(np.diff(finite))
    return {
        "step": grid_step(distinct(np.unique(finite))) if finite.size else None,
        "change": _number(np.median(change)) if change.size else None,
    }


def spikes(
    values: np.ndarray, time: np.ndarray, episodes: Sequence[slice], ends: Collection[str]
) -> dict[str, Any]:
    """Single finite samples of an output (step,) that stand out from a curve which goes on without them.

    count; largest: how far the farthest does; first: the steps of the first few; ends: how many of them are at an end
    of an episode, where what comes next to them alone judges them, and only at those of the `ends` "first" and "last":
    what may jump there is none that is broken.
    """
    steps, sizes, at_ends = [], [], 0
    for episode in episodes:
        found = _inside(values, time, episode)
        there = _at_ends(values, time, episode, [step for step, _ in found], ends)
        at_ends += len(there)
        for step, size in sorted([*found, *there]):
            steps.append(step)
            sizes.append(size)
    return {
        "count": len(steps),
        "largest": max(sizes, default=None),
        "first": steps[: SETTINGS.places_listed],
        "ends": at_ends,
    }


def _inside(values: np.ndarray, time: np.ndarray, episode: slice) -> list[tuple[int, float]]:
    """Which samples with two on either side stand out, and by how much."""
    inside = np.arange(episode.start + 2, episode.stop - 2)
    if not len(inside):
        return []
    with np.errstate(invalid="ignore", divide="ignore"):
        off = _off_line(values, time, inside, -1, 1)
        before = np.abs(_off_line(values, time, inside - 1, -1, 2))
        beside = np.maximum(before, np.abs(_off_line(values, time, inside + 1, -2, 1)))
        forward = np.all([time[inside + k + 1] > time[inside + k] for k in (-2, -1, 0, 1)], axis=0)
        far = np.isfinite(off) & (np.abs(off) > SETTINGS.spike * _usual(off))
        out = forward & far & (beside < SETTINGS.spike_alone * np.abs(off))
    return list(zip(inside[out].tolist(), np.abs(off[out]).tolist(), strict=True))


def _at_ends(
    values: np.ndarray, time: np.ndarray, episode: slice, spiked: Sequence[int], ends: Collection[str]
) -> list[tuple[int, float]]:
    """Which of an episode's two samples at each of the `ends` stand out, and by how much: farther off the line through
    the next two inside than any other is off the line on that side of it. spiked: others that stand out.
    """
    found = []
    broken = [*spiked, episode.start, episode.start + 1, episode.stop - 2, episode.stop - 1]
    inside = np.arange(episode.start + 2, episode.stop - 2)
    for which, end, way in (("first", episode.start, 1), ("last", episode.stop - 1, -1)):
        if which not in ends:
            continue
        others = inside[~np.isin(inside[:, None] + way * np.arange(3), broken).any(axis=1)]
        near = np.abs(np.diff(time[end : end + 4 * way : way]))
        if len(others) < SETTINGS.fewest_beside_end or not 0 < near.max() < 2 * np.median(
            np.diff(time[episode])
        ):
            continue  # over a gap no line is known to go on
        with np.errstate(invalid="ignore", divide="ignore"):
            off = _off_line(values, time, others, way, 2 * way)
            last, next_ = np.abs(_off_line(values, time, np.array([end, end + way]), way, 2 * way))
            without_next = abs(_off_line(values, time, np.array([end]), 2 * way, 3 * way)[0])
            steps = np.abs(np.diff(values[[end + way, end + 2 * way, end + 3 * way]]))
        most = max(
            SETTINGS.spike * _usual(off),
            SETTINGS.spike_at_end * np.abs(off[np.isfinite(off)]).max(initial=0.0),
        )
        if next_ > max(most, SETTINGS.bounce * steps[1]) and without_next < SETTINGS.spike_alone * next_:
            found.append((end + way, float(next_)))
        elif last > max(most, SETTINGS.bounce * steps[0]):
            found.append((end, float(last)))
    return found


def _usual(off: np.ndarray) -> float:
    """What samples usually are off a line, (n,), but for those exactly on it."""
    some = off[np.isfinite(off) & (off != 0)]
    return float(np.median(np.abs(some))) if some.size else np.inf


def _off_line(values, time, steps: np.ndarray, left: int, right: int) -> np.ndarray:
    """How far the values at `steps` (n,) are from the line through those `left` and `right` of them."""
    share = (time[steps] - time[steps + left]) / (time[steps + right] - time[steps + left])
    return values[steps] - values[steps + left] - share * (values[steps + right] - values[steps + left])


def excitation(values: np.ndarray, time: np.ndarray, episodes: Sequence[slice]) -> dict[str, Any]:
    """How an input (step,) moves, from the samples that are finite and whose time (step,) goes forward.

    at_rest: share of the samples that are near 0. bands: share of the power about the mean by frequency, Hz;
    median_frequency, frequency_95: half and 95 % of it lie below. single_frequency: where nearly all
    of the signal and of its changes is, None where they are at several.
    """
    finite = values[np.isfinite(values)]
    rest = np.mean(np.abs(finite) <= SETTINGS.at_rest * np.abs(finite).max()) if finite.size else None
    spectra = [s for s in (_spectrum(values[e], time[e]) for e in episodes) if s is not None]
    return {"at_rest": _number(rest), **_distribution(spectra), "single_frequency": _single(spectra)}


def _places(steps: np.ndarray, time: np.ndarray, interval: np.ndarray) -> dict[str, Any]:
    """How many, and the first few: the step before, its time and the interval to the next, s."""
    return {
        "count": len(steps),
        "longest": _number(np.abs(interval[steps]).max()) if len(steps) else None,
        "first": [
            {"step": int(i), "time": float(time[i]), "interval": float(interval[i])}
            for i in steps[: SETTINGS.places_listed]
        ],
    }


def _extreme(values: np.ndarray, value: float, others: np.ndarray) -> dict[str, Any]:
    """`others`: how many samples are at the other values, nearest first."""
    there = values == value
    visits = int(there[0]) + int(np.count_nonzero(there[1:] & ~there[:-1]))
    return {
        "value": float(value),
        "share": float(there.mean()),
        "visits": visits,
        "neighbours": float(others[: SETTINGS.neighbours].mean() / len(values)) if others.size else 0.0,
    }


def _spectrum(values: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """frequency (line,) Hz, power (line,) of the values and of their changes; None where too few."""
    sound = np.isfinite(values) & np.isfinite(time)
    values, time = values[sound], time[sound]
    if len(time):
        ahead = time > np.concatenate([[-np.inf], np.maximum.accumulate(time)[:-1]])
        values, time = values[ahead], time[ahead]
    if len(time) < SETTINGS.least_spectrum or np.ptp(values) == 0:
        return None
    grid = np.linspace(time[0], time[-1], len(time))
    even = np.interp(grid, time, values)
    window = np.hanning(len(grid) + 2)[1:-1]
    frequency = np.fft.rfftfreq(len(grid), grid[1] - grid[0])[1:]
    power = np.square(np.abs(np.fft.rfft((even - even.mean()) * window)))[1:]
    change = np.gradient(even)
    changes = np.square(np.abs(np.fft.rfft((change - change.mean()) * window)))[1:]
    return frequency, power, changes


def _distribution(spectra) -> dict[str, Any]:
    if not spectra:
        return {"bands": [], "median_frequency": None, "frequency_95": None}
    frequency = np.concatenate([f for f, _, _ in spectra])
    power = np.concatenate([p for _, p, _ in spectra])
    order = np.argsort(frequency)
    frequency, total = frequency[order], np.cumsum(power[order])
    below = total / total[-1]
    edges = frequency[-1] * np.array(SETTINGS.band_edges)
    at_edges = np.concatenate([[0.0], below])[np.searchsorted(frequency, edges, side="right")]
    return {
        "bands": [
            {"low": float(a), "high": float(b), "share": float(share)}
            for a, b, share in zip(edges, edges[1:], np.diff(at_edges), strict=False)
        ],
        "median_frequency": float(frequency[np.searchsorted(below, 0.5)]),
        "frequency_95": float(frequency[np.searchsorted(below, 0.95)]),
    }


def _single(spectra) -> float | None:
    """The frequency, Hz, at which the signal and its changes are in all episodes; None where at several, or at none."""
    found = []
    for frequency, power, changes in spectra:
        peak = int(np.argmax(changes))
        if peak < SETTINGS.fewest_periods or len(changes) < 16:
            return None
        line = slice(peak - 2, peak + 3)
        if (
            changes[line].sum() < SETTINGS.single_line * changes.sum()
            or power[line].sum() < SETTINGS.single_signal * power.sum()
        ):
            return None
        found.append((float(frequency[peak]), float(frequency[0])))
    if not found:
        return None
    peaks, widths = np.array(found).T
    return float(np.median(peaks)) if np.ptp(peaks) <= 2 * widths.max() else None


def _number(value) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None
