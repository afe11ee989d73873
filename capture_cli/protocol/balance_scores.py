"""Scores of effects from the force balance: all at once, without a simulation, wherever the log gives a balance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace

import mujoco
import numpy as np

from capture_cli.diagnosis.score import Score
from capture_cli.errors import LogError
from capture_cli.estimate.motion import Log, SmoothedLog
from capture_cli.model.tasks.base import Task
from capture_cli.protocol.candidates import Candidate
from capture_cli.protocol.fit import Fit
from capture_cli.protocol.prepared_log import PreparedLog
from capture_cli.select.input_timing import InputTiming, input_timings
from capture_cli.select.screening import SETTINGS as SCREENING
from capture_cli.select.screening import Screening, declared_balance, parameters_sd


def screening_of(
    prepared: PreparedLog,
    fitted: np.ndarray,
    candidates: Sequence[Candidate],
    threads: int | None,
    on_step: Callable[[str, int, int], None],
) -> Screening | None:
    """A screening of the candidates on the windows `fitted` (window,); None where the log gives no balance: a joint
    that no sensor shows moves, loops are closed, actuators have states, or little is left between impacts.
    """
    smoothed = smoothed_log(prepared, fitted)
    if smoothed is None:
        return None
    placed, nominal = [c.placed for c in candidates], prepared.task.space.nominal
    try:
        return Screening(smoothed, placed, nominal, threads=threads, on_step=on_step)
    except LogError:  # too short
        return None


def smoothed_log(prepared: PreparedLog, windows: np.ndarray) -> SmoothedLog | None:
    """The log in some `windows` (window,), smoothed; None where it gives no balance."""
    model, own = prepared.task.model, prepared.windows
    if model.neq or model.na:
        return None
    within = np.zeros(len(prepared.log.time), dtype=bool)
    for first, count in zip(own.first[windows], own.samples[windows], strict=True):
        within[first : first + count] = True
    try:
        return SmoothedLog.of(log_of(prepared), prepared.task, within & _between_stops(prepared))
    except LogError:
        return None


def timings_of_inputs(prepared: PreparedLog, threads: int | None) -> tuple[InputTiming, ...]:
    """How the inputs act of which the task does not say it, by what is not held out; none where there is no balance."""
    task = prepared.task
    smoothed = smoothed_log(prepared, ~prepared.split.is_test)
    if smoothed is None:
        return ()
    try:
        balance, whitening = declared_balance(smoothed, task.space.nominal, threads)
    except LogError:  # too short
        return ()
    found, nothing_else = input_timings(balance, whitening, [c.name for c in task.inputs], task.linear)
    if not nothing_else:
        return ()
    return tuple(t for t, c in zip(found, task.inputs, strict=True) if c.linear is None)


def balanced_point(
    prepared: PreparedLog, windows: np.ndarray, point: np.ndarray, threads: int | None
) -> np.ndarray | None:
    """Values (parameter,) of the declared parameters that fill the balance of some `windows` (window,) best, from
    `point` (parameter,) on; None where the log gives none, or where it leaves one of them open: along a ridge it would
    begin anywhere.
    """
    known = prepared.screening
    if known is not None:
        balance, whitening = known.balance, known.whitening
    else:
        smoothed = smoothed_log(prepared, windows)
        if smoothed is None:
            return None
        try:
            balance, whitening = declared_balance(smoothed, point, threads)
        except LogError:  # too short
            return None
    doubt = parameters_sd(balance, whitening)
    return balance.point if doubt.max(initial=0.0) < SCREENING.determined else None


def with_timings(task: Task, timings: Sequence[InputTiming]) -> Task:
    """The task with inputs that act as the log tells, and are held where it does not."""
    linear = {t.name: t.linear for t in timings}
    known = copy(task)
    known.inputs = tuple(
        replace(c, linear=linear.get(c.name, False)) if c.linear is None else c for c in task.inputs
    )
    return known


def log_of(prepared: PreparedLog) -> Log:
    """The arrays of the log."""
    log = prepared.log
    return Log(log.time, log.inputs, log.values, log.sampled, log.episodes)


def score_in_balance(
    screening: Screening, current: Fit, candidates: Sequence[Candidate], polished: int | None = None
) -> None:
    """Fill in the candidates' scores and where a refit with each begins, or why it is out.

    polished: how many are fitted in the balance, as of `Screening.additions`.
    """
    values = [current.point[current.columns(e.name)] for e in current.effects]
    found = {a.placed.name: a for a in screening.additions(current.effects, values, polished)}
    for candidate in candidates:
        candidate.fit = candidate.select = candidate.support = candidate.score = None
        candidate.why_rejected = candidate.start_elsewhere = candidate.start_doubted = None
        candidate.shapes_tried = max(sum(a.placed.name == candidate.name for a in screening.atoms), 1)
        addition = found.get(candidate.name)
        if addition is None:
            candidate.why_rejected = "it moves nothing in this log, or only with the wrong sign"
            continue
        own = len(candidate.placed.effect.parameters)
        start = addition.model.start
        moved = (start[: len(current.point)] - current.point) / current.space.span
        amplitudes = start[len(start) - own :]
        candidate.score = Score(2 * addition.gain, amplitudes, moved, 1.0, addition.response)
        candidate.start = amplitudes
        if addition.gain <= 0:
            candidate.why_rejected = (
                f"blocks that were not fitted are not predicted better (log likelihood {addition.gain:.3g} "
                f"with a standard error of {addition.error:.2g})"
            )


def _between_stops(prepared: PreparedLog) -> np.ndarray:
    """Steps of the log (step,) at which no joint is at an end of its range, by what its sensor says."""
    model, log = prepared.task.model, prepared.log
    free = np.ones(len(log.time), dtype=bool)
    for channel, column in zip(prepared.task.outputs, log.values.T, strict=True):
        if model.sensor_type[channel.sensor] != int(mujoco.mjtSensor.mjSENS_JOINTPOS):
            continue
        joint = int(model.sensor_objid[channel.sensor])
        if model.jnt_limited[joint]:
            low, high = model.jnt_range[joint] + model.jnt_margin[joint] * np.array([1, -1])
            free &= (column > low) & (column < high)
    return free
