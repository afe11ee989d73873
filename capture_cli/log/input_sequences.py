"""The inputs of a log at the model's steps, in its windows and around them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class InputSequencesSettings:
    # A sample this close before a grid point, in steps, belongs to it: times in files are rounded.
    grid_tolerance: float = 1e-3
    # Tapes of all windows up to this size are kept. Larger ones, which overlap, are read off the log when asked for.
    kept_bytes: int = 64 << 20


SETTINGS = InputSequencesSettings()


@dataclass(frozen=True)
class CachedSequences:
    """kept (window, lead + stop, input): from `lead` steps before each window begins to `stop` steps after."""

    kept: np.ndarray
    lead: int = 0

    @property
    def stop(self) -> int:
        """How many steps after each window begins the tapes reach."""
        return self.kept.shape[1] - self.lead

    def rows(self, keep: np.ndarray, stop: int) -> CachedSequences:
        """Those of the windows at `keep`, as far as `stop`."""
        return CachedSequences(self.kept[keep, : self.lead + stop], self.lead)

    def inputs(self, row: np.ndarray, begin: int, stop: int) -> np.ndarray:
        """Inputs (row, step, input) of the windows `row` (row,), from `begin` to `stop` steps after each begins."""
        return self.kept[row, self.lead + begin : self.lead + stop]


@dataclass(frozen=True)
class LogSequences:
    """The same inputs, to the last digit, read off the log when they are asked for.

    time (step,), s; logged (step, input); linear (input,), as for `inputs_at`. first (window,): the step of the log
    that each window begins at. known (window, 2): from which step of the log, and up to which, inputs are known to it.
    sums_from (window,): which of those sums of inputs begin at, as for `inputs_at`.
    """

    time: np.ndarray
    logged: np.ndarray
    timestep: float
    linear: np.ndarray
    first: np.ndarray
    known: np.ndarray
    sums_from: np.ndarray
    lead: int
    stop: int

    def rows(self, keep: np.ndarray, stop: int) -> LogSequences:
        """Those of the windows at `keep`, as far as `stop`."""
        return replace(
            self, first=self.first[keep], known=self.known[keep], sums_from=self.sums_from[keep], stop=stop
        )

    def inputs(self, row: np.ndarray, begin: int, stop: int) -> np.ndarray:
        """Inputs (row, step, input) of the windows `row` (row,), from `begin` to `stop` steps after each begins."""
        steps = self.timestep * np.arange(begin, stop)
        tapes = np.empty((len(row), len(steps), self.logged.shape[1]))
        for tape, window in zip(tapes, row, strict=True):
            known = slice(*self.known[window])
            times = self.time[self.first[window]] + steps
            tape[...] = inputs_at(
                times,
                self.time[known],
                self.logged[known],
                self.timestep,
                self.linear,
                sums_from=self.sums_from[window],
            )
        return tapes


InputSequences = CachedSequences | LogSequences


def input_sequences(
    time: np.ndarray,
    inputs: np.ndarray,
    timestep: float,
    linear: np.ndarray,
    *,
    first: np.ndarray,
    known: np.ndarray,
    lead: int,
    stop: int,
) -> InputSequences:
    """Tapes of windows from `lead` steps before each to `stop` after, as of LogSequences; kept where they are small.

    Where the log does not reach so far, they hold its first and last values.
    """
    steps = timestep * np.arange(-lead, stop)
    each = ((time[a] + steps, slice(*span)) for a, span in zip(first, known, strict=True))
    if len(first) * len(steps) * inputs.shape[1] * inputs.itemsize <= SETTINGS.kept_bytes:
        kept = [inputs_at(times, time[own], inputs[own], timestep, linear) for times, own in each]
        return CachedSequences(np.stack(kept), lead)
    sums_from = np.array([_sums_from(times, time[own], timestep) for times, own in each])
    return LogSequences(time, inputs, timestep, linear, first, known, sums_from, lead, stop)


def inputs_at(
    times: np.ndarray,
    time: np.ndarray,
    inputs: np.ndarray,
    timestep: float,
    linear: np.ndarray,
    sums_from: int | None = None,
) -> np.ndarray:
    """Inputs (step, input), sampled at `time`, for the steps that begin at `times`: held, or interpolated where
    `linear` (input,).

    Of one that changes inside a step it is the mean over the step; of an interpolated one what it is at the step's
    beginning, not in its middle: a step kicks velocities and then moves positions with the new ones, which is leapfrog
    with kicks at `times`, and positions are right to the second order (docs/dev/findings.md).

    sums_from: the sample that the sums begin at from which means are worked out; None for the first that is needed. Its
    choice shows in the last digit: part of a tape is as it is in the whole only where both have the same.
    """
    held, changes = _held_through(time, times, timestep)
    values = inputs[held]
    if changes.size:
        values[changes] = _mean_from(time, inputs, times[changes], timestep, sums_from)
    if linear.any():
        near = slice(max(held.min() - 1, 0), held.max() + 3)
        for k in np.flatnonzero(linear):
            values[:, k] = np.interp(times, time[near], inputs[near, k])
    return values


def _sums_from(times: np.ndarray, time: np.ndarray, timestep: float) -> int:
    """Where `inputs_at` begins its sums for the whole of `times`."""
    _, changes = _held_through(time, times, timestep)
    return int(_held(time, times[changes[:1]], 0.0)[0]) if changes.size else 0


def _held_through(time: np.ndarray, times: np.ndarray, timestep: float) -> tuple[np.ndarray, np.ndarray]:
    """Which of the samples at `time` is held at the beginning of each step, (step,), and the steps in which another
    follows.
    """
    tolerance = SETTINGS.grid_tolerance * timestep
    held = _held(time, times, tolerance)
    return held, np.flatnonzero(_held(time, times + timestep, -tolerance) > held)


def _held(time: np.ndarray, times: np.ndarray, tolerance: float) -> np.ndarray:
    """Which of the samples at `time` are held at `times`: the last of those before; the first before all."""
    return np.clip(np.searchsorted(time, times + tolerance, side="right") - 1, 0, len(time) - 1)


def _mean_from(
    time: np.ndarray, inputs: np.ndarray, times: np.ndarray, duration: float, sums_from: int | None
) -> np.ndarray:
    """The mean of held inputs over `duration` s from each of `times`, (time, input); sums_from as of `inputs_at`."""
    edges = np.stack([times, times + duration])
    held = _held(time, edges, 0.0)
    own = slice(held.min() if sums_from is None else sums_from, held.max() + 1)
    time, inputs, held = time[own], inputs[own], held - own.start
    whole = np.zeros_like(inputs)
    np.cumsum(inputs[:-1] * np.diff(time)[:, None], axis=0, out=whole[1:])
    begin, end = whole[held] + inputs[held] * (edges - time[held])[..., None]
    return (end - begin) / duration
