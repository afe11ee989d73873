"""The windows of a log, by the clock of simulations."""

from __future__ import annotations

import numpy as np

from capture_cli.sim.windows import Windows, cut
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.tasks.base import Task


def clock(log: MeasuredLog) -> np.ndarray:
    """Time (step,), s, by the clock of simulations, which counts from the log's first time.

    By a clock that began long before the log the phase of a force that repeats would turn many times over within a
    finite difference of its frequency.
    """
    return log.time - log.time[0]


def cut_log(log: MeasuredLog, task: Task, duration: float | None) -> Windows:
    """Windows of `duration` s, or of whole episodes where None, by the clock of simulations."""
    return cut(
        time=clock(log),
        inputs=log.inputs,
        outputs=log.values,
        episodes=log.episodes,
        timestep=task.timestep,
        duration=duration,
        linear=task.linear,
        sampled=log.sampled,
    )
