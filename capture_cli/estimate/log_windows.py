"""The windows of a log, by the clock of simulations."""

from dataclasses import replace

import numpy as np

from capture_cli.log.arrays import Log
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import Spans, Windows, at_spans, cut
from capture_cli.model.tasks.base import Task


def clock(log: MeasuredLog) -> np.ndarray:
    """Time (step,), s, by the clock of simulations, which counts from the log's first time.

    By a clock that began long before the log the phase of a force that repeats would turn many times over within a
    finite difference of its frequency.
    """
    return log.time - log.time[0]


def clocked(log: MeasuredLog) -> Log:
    """The log by the clock of simulations."""
    return replace(log.arrays, time=clock(log))


def cut_log(log: MeasuredLog, task: Task, duration: float | None) -> Windows:
    """Windows of `duration` s, or of whole episodes where None, by the clock of simulations."""
    return cut(clocked(log), duration, task.timestep, task.holds)


def windows_at(log: MeasuredLog, task: Task, spans: Spans) -> Windows:
    """Windows at `spans` of the log, which may overlap, by the clock of simulations."""
    return at_spans(spans, clocked(log), task.timestep, task.holds)
