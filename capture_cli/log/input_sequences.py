"""The inputs of a log at the model's steps, in its windows and around them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    # A sample this close before a grid point, in steps, belongs to it: times in files are rounded.
    grid_tolerance: float = 1e-3
    # Sequences of all windows up to this size are kept. Larger ones, which overlap, are read off the log when asked.
    kept_bytes: int = 64 << 20


@dataclass(frozen=True)
class Hold:
    """How an input acts between samples.

    commands: that there are from one sample to the next, evenly in time and on a cubic in value, each held until the
    next: 1 where the sample itself is held, inf where the input is interpolated linearly. late: s, after the time of
    its sample; before it where negative.
    """

    commands: float = 1.0
    late: float = 0.0


HELD, EVENLY = Hold(), Hold(np.inf)


@dataclass(frozen=True)
class LoggedInputs:
    """Inputs `values` (step, input) of a log, sampled at time (step,) s, each of which acts as one of `holds` says, for
    a model that takes steps of `timestep` s.
    """

    time: np.ndarray
    values: np.ndarray
    timestep: float
    holds: Sequence[Hold]

    def part(self, steps: slice) -> Self:
        """Those of some steps."""
        return replace(self, time=self.time[steps], values=self.values[steps])

    def at(self, times: np.ndarray, sums_from: int | None = None) -> np.ndarray:
        """Inputs (model step, input) for the steps that begin at `times`.

        Of one that changes inside a step it is the mean over the step; of an interpolated one what it is at the step's
        beginning, not in its middle: a step kicks velocities and then moves positions with the new ones, which is
        leapfrog with kicks at `times`, and positions are right to the second order (docs/dev/findings.md).

        sums_from: the sample that the sums begin at from which means are worked out; None for the first that is needed.
        Its choice shows in the last digit: part of a sequence is as it is in the whole only where both have the same.
        """
        values = np.empty((len(times), self.values.shape[1]))
        for hold in set(self.holds):
            own, at = self._acting(hold), times - hold.late
            near = self._near(at)
            if np.isinf(hold.commands):
                columns = self.values[near][:, own].T
                values[:, own] = np.stack([np.interp(at, self.time[near], c) for c in columns], axis=1)
                continue
            begin = near.start if sums_from is None else sums_from
            commands = self._each_command(hold, slice(begin, near.stop))
            values[:, own] = commands._held_at(at, None if sums_from is None else 0)
        return values

    def _each_command(self, hold: Hold, samples: slice) -> Self:
        """The inputs that act so, with a sample for each command from the first of `samples` to the last."""
        before = min(samples.start, 1)
        wider = self.part(slice(samples.start - before, samples.stop + 1))
        number, own = int(hold.commands), slice(before, before + len(self.time[samples]))
        slopes = _slopes(wider.time[:, None], values := wider.values[:, self._acting(hold)])
        time = wider.time[own, None]
        commands = _between(time, values[own], slopes[own], number)
        # of slope 1 the cubic is a line
        each = _between(time, time, np.ones_like(time), number)[:, 0]
        return replace(self, time=each, values=commands, holds=[HELD] * commands.shape[1])

    def _acting(self, hold: Hold) -> np.ndarray:
        """Which inputs act so, (input,)."""
        return np.array([own == hold for own in self.holds], dtype=bool)

    def sums_from(self, times: np.ndarray) -> int:
        """Where `at` begins its sums for the whole of `times`."""
        firsts = []
        for hold in {own for own in self.holds if np.isfinite(own.commands)}:
            at = times - hold.late
            near = self._near(at)
            commands = self._each_command(hold, near)
            _, changes = commands._held_through(at)
            if changes.size:
                before = int(commands._held(at[changes[:1]], 0.0)[0] // hold.commands)
                firsts.append(near.start + before)
        return min(firsts, default=self._near(times).start)

    def _near(self, times: np.ndarray) -> slice:
        """The samples that may act at `times`."""
        first, last = self._held(np.array([times.min(), times.max() + self.timestep]), 0.0)
        return slice(max(int(first) - 1, 0), int(last) + 3)

    def _held_at(self, times: np.ndarray, sums_from: int | None) -> np.ndarray:
        """As `at`, where all are held."""
        held, changes = self._held_through(times)
        values = self.values[held]
        if changes.size:
            values[changes] = self._mean_from(times[changes], sums_from)
        return values

    def _held_through(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which of the samples is held at the beginning of each step, (model step,), and the steps in which another
        follows.
        """
        tolerance = SETTINGS.grid_tolerance * self.timestep
        held = self._held(times, tolerance)
        return held, np.flatnonzero(self._held(times + self.timestep, -tolerance) > held)

    def _held(self, times: np.ndarray, tolerance: float) -> np.ndarray:
        """Which of the samples are held at `times`: the last of those before; the first before all."""
        last = np.searchsorted(self.time, times + tolerance, side="right") - 1
        return np.clip(last, 0, len(self.time) - 1)

    def _mean_from(self, times: np.ndarray, sums_from: int | None) -> np.ndarray:
        """The mean of held inputs over the step from each of `times`, (time, input); sums_from as of `at`."""
        edges = np.stack([times, times + self.timestep])
        held = self._held(edges, 0.0)
        own = slice(held.min() if sums_from is None else sums_from, held.max() + 1)
        time, values, held = self.time[own], self.values[own], held - own.start
        whole = np.zeros_like(values)
        np.cumsum(values[:-1] * np.diff(time)[:, None], axis=0, out=whole[1:])
        begin, end = whole[held] + values[held] * (edges - time[held])[..., None]
        return (end - begin) / self.timestep


def _slopes(time: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Of samples (step, column) at time (step, 1): that of the parabola through each and its two neighbours; at the
    ends of the chord.
    """
    gaps = np.diff(time, axis=0)
    chords = np.diff(samples, axis=0) / gaps
    inside = (gaps[1:] * chords[:-1] + gaps[:-1] * chords[1:]) / (gaps[1:] + gaps[:-1])
    return np.concatenate([chords[:1], inside, chords[-1:]]) if len(chords) else np.zeros_like(samples)


def _between(time: np.ndarray, samples: np.ndarray, slopes: np.ndarray, number: int) -> np.ndarray:
    """`number` values from each sample (step, column) at time (step, 1) to the next, on the cubic of both and of their
    slopes (Hermite), and the last sample: (..., column).
    """
    share = (np.arange(number) / number)[:, None]
    gaps, rises = np.diff(time, axis=0)[:, None], np.diff(samples, axis=0)[:, None]
    first, last = gaps * slopes[:-1, None], gaps * slopes[1:, None]
    cubic = share * (first + last - 2 * rises)
    between = samples[:-1, None] + share * (first + share * (3 * rises - 2 * first - last + cubic))
    return np.concatenate([between.reshape(-1, samples.shape[1]), samples[-1:]])


@dataclass(frozen=True)
class CachedSequences:
    """kept (window, lead + stop, input): from `lead` steps before each window begins to `stop` steps after."""

    kept: np.ndarray
    lead: int = 0

    @property
    def stop(self) -> int:
        """How many steps after each window begins the sequences reach."""
        return self.kept.shape[1] - self.lead

    def rows(self, keep: np.ndarray, stop: int) -> Self:
        """Those of the windows at `keep`, as far as `stop`."""
        return CachedSequences(self.kept[keep, : self.lead + stop], self.lead)

    def inputs(self, row: np.ndarray, begin: int, stop: int) -> np.ndarray:
        """Inputs (row, step, input) of the windows `row` (row,), from `begin` to `stop` steps after each begins."""
        return self.kept[row, self.lead + begin : self.lead + stop]


@dataclass(frozen=True)
class LogSequences:
    """The same inputs, to the last digit, read off the log when they are asked for.

    first (window,): the step of the log that each window begins at. known (window, 2): from which step of the log, and
    up to which, inputs are known to it. sums_from (window,): which of those sums begin at, as for `LoggedInputs.at`.
    """

    logged: LoggedInputs
    first: np.ndarray
    known: np.ndarray
    sums_from: np.ndarray
    lead: int
    stop: int

    def rows(self, keep: np.ndarray, stop: int) -> Self:
        """Those of the windows at `keep`, as far as `stop`."""
        return replace(
            self, first=self.first[keep], known=self.known[keep], sums_from=self.sums_from[keep], stop=stop
        )

    def inputs(self, row: np.ndarray, begin: int, stop: int) -> np.ndarray:
        """Inputs (row, step, input) of the windows `row` (row,), from `begin` to `stop` steps after each begins."""
        logged = self.logged
        steps = logged.timestep * np.arange(begin, stop)
        sequences = np.empty((len(row), len(steps), logged.values.shape[1]))
        for sequence, window in zip(sequences, row, strict=True):
            times = logged.time[self.first[window]] + steps
            sequence[...] = logged.part(slice(*self.known[window])).at(times, self.sums_from[window])
        return sequences


InputSequences = CachedSequences | LogSequences


def input_sequences(
    logged: LoggedInputs, *, first: np.ndarray, known: np.ndarray, lead: int, stop: int
) -> InputSequences:
    """Inputs of windows from `lead` steps before each to `stop` after, as of LogSequences; kept where they are small.

    Where the log does not reach so far, they hold its first and last values.
    """
    steps = logged.timestep * np.arange(-lead, stop)
    each = ((logged.time[a] + steps, logged.part(slice(*span))) for a, span in zip(first, known, strict=True))
    values = logged.values
    if len(first) * len(steps) * values.shape[1] * values.itemsize <= SETTINGS.kept_bytes:
        return CachedSequences(np.stack([own.at(times) for times, own in each]), lead)
    sums_from = np.array([own.sums_from(times) for times, own in each])
    return LogSequences(logged, first, known, sums_from, lead, stop)
