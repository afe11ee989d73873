"""The same log as other loggers would have written it, and the task file that goes with it; or another simulator's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace

import numpy as np

from benchmarks._planted_logs.machines import RATE
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks.base import Task

PLAIN, SLOW, NO_WINDOW, HALF, QUARTER, LATE, FILTERED, ELSEWHERE = (
    "plain",
    "slow",
    "no-window",
    "half-rate",
    "quarter-rate",
    "row-late",
    "filtered",
    "elsewhere",
)
CUTOFF = 1 / 8  # of the sampling rate
SETTLING = 64  # samples that the filter has seen before an episode begins
SLOWLY = 50.0  # Hz: what servos on one bus are told, and read

Dress = Callable[[MeasuredLog], MeasuredLog]


def _every(rows: int) -> Dress:
    """Each so many-th row is kept: between two rows the commands change, as they did."""

    def thinned(log: MeasuredLog) -> MeasuredLog:
        kept = [np.arange(e.start, e.stop, rows) for e in log.episodes]
        each = np.concatenate(kept)
        return replace(
            log,
            time=log.time[each],
            inputs=log.inputs[each],
            outputs=log.outputs[each],
            episode_ends=np.cumsum([len(k) for k in kept]),
        )

    return thinned


def _row_late(log: MeasuredLog) -> MeasuredLog:
    """Each row has the command that led to it: it acted from the row before on."""
    inputs = log.inputs.copy()
    for episode in log.episodes:
        inputs[episode.start + 1 : episode.stop] = log.inputs[episode][:-1]
    return replace(log, inputs=inputs)


def _filtered(log: MeasuredLog) -> MeasuredLog:
    """Outputs, noise and all, behind a causal low-pass of second order (Butterworth)."""
    from scipy.signal import butter, lfilter

    numerator, denominator = butter(2, 2 * CUTOFF)
    outputs = log.outputs.copy()
    for episode in log.episodes:
        own = log.outputs[episode]
        before = 2 * own[0] - own[SETTLING:0:-1]  # the motion goes on backwards as it begins
        seen = np.concatenate([before, own]) - before[0]
        outputs[episode] = before[0] + lfilter(numerator, denominator, seen, axis=0)[SETTLING:]
    return replace(log, outputs=outputs)


DRESSES: Mapping[str, Dress] = {
    PLAIN: lambda log: log,
    SLOW: lambda log: log,
    NO_WINDOW: lambda log: log,
    HALF: _every(2),
    QUARTER: _every(4),
    LATE: _row_late,
    FILTERED: _filtered,
    ELSEWHERE: lambda log: log,
}


def rate_in(name: str) -> float:
    """Commands and rows per second of the recording that is put in the dress `name`."""
    return SLOWLY if name == SLOW else RATE


def dressed(name: str, task: Task, log: MeasuredLog) -> tuple[Task, MeasuredLog]:
    """Task and log of a plain recording in the dress `name`."""
    if name == NO_WINDOW:
        task = copy(task)
        task.log = replace(task.log, window=None)
    return task, DRESSES[name](log)
