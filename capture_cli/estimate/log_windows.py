"""The windows of a log, by the clock of simulations."""

from dataclasses import replace

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.log.arrays import Log
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import SETTINGS as WINDOWS
from capture_cli.log.windows import Spans, Windows, at_spans, cut, usual_interval
from capture_cli.model.tasks.base import Task


@frozen
class SETTINGS:
    """usual: s, of a window where none is set: errors of several joints stay near linear in what is missing, and what
    acts over its time shows. samples: that it holds at least.
    """

    usual: float = 0.5
    samples: int = 50


def window_of(log: MeasuredLog, task: Task, window: float | None = None) -> float | None:
    """s, of the windows that a log is cut into: `window`, or the task's own, or what suits most machines; None, whole
    episodes, where these are hardly longer, or are what an action says.
    """
    told = task.log.window if window is None else window
    if told is not None or log.actions is not None:
        return told
    usual = max(SETTINGS.usual, SETTINGS.samples * interval_of(log))
    return float(f"{usual:.2g}") if log.longest >= WINDOWS.in_episode * usual else None


def interval_of(log: MeasuredLog) -> float:
    """s, between samples of most episodes."""
    return float(np.median([usual_interval(log.time[e], log.sampled[e]) for e in log.episodes]))


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
