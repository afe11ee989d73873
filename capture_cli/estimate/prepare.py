"""A log made ready for a task: checked, cut into windows, with initial states, noise floor and split."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture_cli.estimate.difference_step import difference_step
from capture_cli.estimate.initial_states.of_windows import log_initial_states
from capture_cli.estimate.log_balance import timings_of_inputs, with_timings
from capture_cli.estimate.log_requirements import (
    check_changes,
    check_fits,
    check_fitted,
    check_long_enough,
    check_step,
)
from capture_cli.estimate.log_windows import cut_log, window_of
from capture_cli.estimate.noise.noise_floor import NoiseFloor, noise_floor
from capture_cli.estimate.prepared_log import PreparedLog, attitudes
from capture_cli.estimate.split import Divided, EarlierSplit, NewSplit
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.quaternion_signs import continuous
from capture_cli.model.tasks.base import Task


@dataclass(frozen=True)
class Excerpt:
    """Some windows of a log, by their numbers (window,), and the step of differences, which is known."""

    windows: np.ndarray
    difference_step: float


USUAL_SPLIT = NewSplit()


def prepare(
    log: MeasuredLog,
    task: Task,
    *,
    window: float | None = None,
    split: NewSplit | EarlierSplit = USUAL_SPLIT,
    excerpt: Excerpt | None = None,
    threads: int | None = None,
) -> PreparedLog:
    """Check that the log fits the task, and make it ready, or an excerpt of it. Raises LogError or OptionError.

    window: s; the task's own where None, and where that has none what suits most machines.
    """
    check_fits(log, task)
    turned = continuous(log.outputs, log.episodes, attitudes(task), log.sampled)
    log = replace(log, outputs=turned)
    duration = window_of(log, task, window)
    check_long_enough(log, duration)
    check_step(log, task, duration)
    windows = cut_log(log, task, duration)
    if excerpt is not None:
        windows = windows.rows(excerpt.windows)
    # half a window within these: over how long repeats are compared
    repeated_samples = (16, 100)
    noise = noise_floor(
        log.arrays,
        [c.noise_sd for c in task.outputs],
        driven_by=driven_by(log),
        block=int(np.clip(np.median(windows.samples) / 2, *repeated_samples)),
        attitudes=attitudes(task),
    )
    check_changes(log, task, noise.sd)
    initial = log_initial_states(log, task, windows, noise, threads)
    divided = Divided(
        windows.first,
        windows.samples,
        windows.episode,
        log.recording,
        log.recording_names,
        log.longest,
        chosen=None if duration in (window, task.log.window) else duration,
    )
    prepared = PreparedLog(task, log, windows, initial, noise, split.of(divided))
    check_fitted(prepared)
    if excerpt is not None:
        return replace(prepared, difference_step=excerpt.difference_step)
    if any(c.hold is None for c in task.inputs):
        timings, balanced = timings_of_inputs(prepared, threads)
        known = with_timings(task, timings)
        if known.holds != prepared.task.holds:
            prepared = prepare(log, known, window=window, split=split, threads=threads)
            return replace(prepared, input_timings=timings)
        prepared = replace(prepared, task=known, input_timings=timings, balanced=balanced)
    step, rollouts = difference_step(prepared, threads)
    return replace(prepared, difference_step=step, rollouts=rollouts)


def driven_by(log: MeasuredLog) -> Sequence[np.ndarray]:
    """What drove each episode: its inputs (step, input), or its action."""
    return [log.inputs[e] for e in log.episodes] if log.actions is None else log.actions


def with_noise(prepared: PreparedLog, noise: NoiseFloor, threads: int | None) -> PreparedLog:
    """The log with another noise floor, which its initial states are known by, too."""
    initial = log_initial_states(prepared.log, prepared.task, prepared.windows, noise, threads)
    return replace(prepared, noise=noise, initial=initial)
