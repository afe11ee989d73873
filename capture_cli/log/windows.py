"""A measured log cut into windows on the model's time grid: multiple shooting.

Each window restarts the state at one of the log's samples. Inputs are brought onto the grid of model steps (held or
interpolated); simulated outputs are interpolated to the log's own sampling times, however uneven those are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.log.arrays import Log
from capture_cli.log.input_sequences import SETTINGS as INPUT_SEQUENCES
from capture_cli.log.input_sequences import Hold, InputSequences, LoggedInputs, input_sequences


@frozen
class SETTINGS:
    # A gap this many usual sampling intervals long ends a window: nobody knows what drove the machine in it.
    gap_factor: float = 20.0
    # of a window: an episode a little shorter still is one
    shortest_episode: float = 0.9
    fewest_in_window: int = 4  # samples: with fewer, the start of a window explains all of it
    in_episode: int = 4  # windows, where one is to be chosen: so that some can be held out
    # s of inputs kept from before each window: what a late or sluggish actuator still answers to at its start
    lead: float = 4.0
    # of the time since an episode began: how far off a clock may be, and inputs are kept from after each window
    most_drift: float = 0.05


@dataclass(frozen=True)
class Windows:
    """Windows of a log, padded to one shape.

    episode (window,): which episode each comes from. first (window,): its first step in the log; None of what is in no
    log, which effects that know one are not to look up there.
    time (window,): s, at its start, by the clock it was cut by. elapsed (window,): s, since its episode began.
    known (window,): s, since its inputs are known: since then, or since a gap.
    grid_steps (window,): model steps needed.
    sequences: inputs at the model's steps, in the windows and around them.
    index (window, step), weight (window, step): a sample lies between grid points index and index + 1, at weight.
    measured (window, step, output): 0 where not sampled. mask (window, step): False for padding.
    sampled (window, step, output): False for padding, and where an output has no sample.
    """

    episode: np.ndarray
    first: np.ndarray | None
    time: np.ndarray
    elapsed: np.ndarray
    known: np.ndarray
    grid_steps: np.ndarray
    sequences: InputSequences
    index: np.ndarray
    weight: np.ndarray
    measured: np.ndarray
    mask: np.ndarray
    sampled: np.ndarray
    timestep: float

    def __len__(self) -> int:
        return len(self.episode)

    @property
    def grid(self) -> int:
        """Model steps of the longest window."""
        return int(self.grid_steps.max(initial=0))

    @property
    def controls(self) -> np.ndarray:
        """Inputs inside the windows, (window, grid, input)."""
        return self.sequences.inputs(np.arange(len(self)), 0, self.grid)

    @property
    def known_lead(self) -> np.ndarray:
        """How many of the inputs before each window are known, (window,), in model steps."""
        return np.minimum(np.rint(self.known / self.timestep).astype(int), self.sequences.lead)

    @property
    def samples(self) -> np.ndarray:
        """How many steps each window has, (window,)."""
        return self.mask.sum(axis=1)

    def rows(self, keep: np.ndarray) -> Self:
        """The windows at `keep` (indices or a mask), with no more padding than they need."""
        keep = np.arange(len(self))[keep]
        steps = int(self.samples[keep].max(initial=0))
        spare = self.grid - int(self.grid_steps[keep].max(initial=0))
        return replace(
            self,
            episode=self.episode[keep],
            first=None if self.first is None else self.first[keep],
            time=self.time[keep],
            elapsed=self.elapsed[keep],
            known=self.known[keep],
            grid_steps=self.grid_steps[keep],
            sequences=self.sequences.rows(keep, self.sequences.stop - spare),
            index=self.index[keep, :steps],
            weight=self.weight[keep, :steps],
            measured=self.measured[keep, :steps],
            mask=self.mask[keep, :steps],
            sampled=self.sampled[keep, :steps],
        )

    def sample(self, sensors: np.ndarray, row: np.ndarray) -> np.ndarray:
        """Grid values (simulation, grid, output) of the windows `row` (simulation,) at their sampling times."""
        index, weight = self.index[row], self.weight[row, :, None]
        simulation = np.arange(len(row))[:, None]
        before = sensors[simulation, index]
        values = sensors[simulation, np.minimum(index + 1, sensors.shape[1] - 1)]
        # before + weight * (after - before), in place
        values -= before
        values *= weight
        values += before
        return values


@dataclass(frozen=True)
class Spans:
    """Where windows are in a log, (window,) each: their episode, the step since which inputs are known, their first
    step, and the one after their last.
    """

    episode: np.ndarray
    known_since: np.ndarray
    first: np.ndarray
    stop: np.ndarray

    def __len__(self) -> int:
        return len(self.episode)


def cut(
    samples: Log, duration: float | None, timestep: float, holds: Sequence[Hold], *, has_gaps: bool = True
) -> Windows:
    """Windows of `duration` seconds (whole episodes where None) of every episode.

    timestep: the model's, s. holds: how each input acts between steps. No step is in two windows, and none is left out
    but one that stands alone between two gaps. The tail of an episode that is shorter than half a window is joined to
    the window before it. has_gaps: False where time is known to have none, however uneven it is.
    """
    time, sampled = samples.time, samples.sampled
    spans = [
        (number, known_since, a, b)
        for number, steps in enumerate(samples.episodes)
        for known_since, a, b in _spans(
            time[steps],
            steps.start,
            duration,
            usual_interval(time[steps], sampled[steps]) if has_gaps else np.inf,
        )
    ]
    return at_spans(Spans(*np.array(spans).T), samples, timestep, holds)


def at_spans(spans: Spans, samples: Log, timestep: float, holds: Sequence[Hold]) -> Windows:
    """The windows of a log at `spans`, which may overlap; the rest is as for `cut`."""
    time, episodes = samples.time, samples.episodes
    episode, known_since, first, stop = spans.episode, spans.known_since, spans.first, spans.stop
    elapsed = time[first] - time[[episodes[number].start for number in episode]]
    known = time[first] - time[known_since]
    lasts = (time[stop - 1] - time[first]) / timestep
    grid_steps = np.floor(lasts + INPUT_SEQUENCES.grid_tolerance).astype(int) + 2
    lead = _steps(known.max(), timestep)
    ahead = _steps(SETTINGS.most_drift * elapsed.max(), timestep)
    sequences = input_sequences(
        LoggedInputs(time, samples.inputs, timestep, holds),
        first=first,
        # the input after a window's last sample is known, if not an episode's
        known=np.stack([known_since, [episodes[number].stop for number in episode]], axis=1),
        lead=lead,
        stop=int(grid_steps.max()) + ahead,
    )
    mask = _padded(np.ones(len(time), dtype=bool), first, stop)
    position = np.where(mask, _padded(time, first, stop) - time[first][:, None], 0.0) / timestep
    index = np.floor(position + INPUT_SEQUENCES.grid_tolerance).astype(np.int64)
    return Windows(
        episode=episode,
        first=first,
        time=time[first],
        elapsed=elapsed,
        known=known,
        grid_steps=grid_steps,
        sequences=sequences,
        index=index,
        weight=np.maximum(position - index, 0.0),
        measured=_padded(samples.outputs, first, stop),
        mask=mask,
        sampled=_padded(samples.sampled, first, stop),
        timestep=timestep,
    )


def _padded(values: np.ndarray, first: np.ndarray, stop: np.ndarray) -> np.ndarray:
    """`values` (step, ...) from `first` to `stop` (window,) of each window, (window, step, ...), 0 after that."""
    padded = np.zeros((len(first), int((stop - first).max()), *values.shape[1:]), dtype=values.dtype)
    for window, a, b in zip(padded, first, stop, strict=True):
        window[: b - a] = values[a:b]
    return padded


def usual_interval(time: np.ndarray, sampled: np.ndarray) -> float:
    """s, between samples of the output that has most of them. time (step,), sampled (step, output).

    Of all steps, that is, unless every output is sparse: merged from several logs, steps may be next to each other.
    """
    if len(time) < 2:
        return 0.0
    some = sampled[:, sampled.sum(axis=0) > 1]
    if some.all(axis=0).any() or not some.size:
        return float(np.median(np.diff(time)))
    return min(float(np.median(np.diff(time[own]))) for own in some.T)


def _spans(time: np.ndarray, offset: int, duration: float | None, usual: float) -> list[tuple[int, int, int]]:
    """Of each window of one episode: since which step its inputs are known, and its [first, last) steps.

    usual: s, between samples.
    """
    spans = []
    for a, b in _without_gaps(time, usual):
        if duration is None:
            spans.append((offset + a, offset + a, offset + b))
            continue
        tolerance = 0.5 * float(np.median(np.diff(time[a:b]))) if b - a > 1 else 0.0
        count = max(1, round((time[b - 1] - time[a] + 2 * tolerance) / duration))
        edges = a + np.searchsorted(time[a:b], time[a] + duration * np.arange(count) - tolerance)
        spans += [(offset + a, offset + i, offset + j) for i, j in _with_two_samples(edges, b)]
    return [(known, i, j) for known, i, j in spans if j - i >= 2]


def _with_two_samples(edges: np.ndarray, stop: int) -> list[tuple[int, int]]:
    """[first, last) between neighbouring edges; one that holds a single sample is joined to the one before it."""
    kept = [int(edges[0])]
    for edge in [int(e) for e in edges[1:]]:
        if edge - kept[-1] >= 2 and stop - edge >= 2:
            kept.append(edge)
    return list(zip(kept, [*kept[1:], stop], strict=True))


def stretches(time: np.ndarray, sampled: np.ndarray, episodes: Sequence[slice]) -> list[slice]:
    """The steps of each of the episodes, from gap to gap. time (step,) s; sampled (step, output)."""
    return [
        slice(steps.start + a, steps.start + b)
        for steps in episodes
        for a, b in _without_gaps(time[steps], usual_interval(time[steps], sampled[steps]))
    ]


def _without_gaps(time: np.ndarray, usual: float) -> list[tuple[int, int]]:
    breaks = gaps(time, usual) + 1
    return list(zip([0, *breaks], [*breaks, len(time)], strict=True))


def gaps(time: np.ndarray, usual: float) -> np.ndarray:
    """The steps of an episode, time (step,) s, that a gap follows, (gap,). usual: s, between samples."""
    if len(time) < 3:
        return np.zeros(0, dtype=int)
    return np.flatnonzero(np.diff(time) > SETTINGS.gap_factor * usual)


def _steps(duration: float, timestep: float) -> int:
    """Model steps that cover `duration` s, or `lead` where that is shorter."""
    return int(np.ceil(min(duration, SETTINGS.lead) / timestep - INPUT_SEQUENCES.grid_tolerance))


def at_times(series: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """`series` (..., grid, column) at fractional grid points `steps` (..., grid, 1).

    Beyond either end it goes on as it does between the last two points, so that a start shows no kink.
    """
    last = max(series.shape[-2] - 2, 0)
    before = np.clip(np.floor(steps), 0, last).astype(int)
    weight = steps - before
    left = np.take_along_axis(series, before, axis=-2)
    right = np.take_along_axis(series, np.minimum(before + 1, series.shape[-2] - 1), axis=-2)
    # exactly the right point, not left + (right - left), where the weight is 1
    return np.where(weight == 1, right, left + weight * (right - left))
