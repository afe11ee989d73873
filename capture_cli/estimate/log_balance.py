"""The force balance of a prepared log: its smoothed motion, how its inputs act, and where it has the parameters."""

from collections.abc import Sequence

import mujoco
import numpy as np

from capture_cli.errors import LogError
from capture_cli.estimate.balance.balanced_fits import SETTINGS as BALANCED_FITS
from capture_cli.estimate.balance.balanced_fits import by_parameter, declared_balance, parameters_sd
from capture_cli.estimate.balance.input_timing import InputTiming, input_timings
from capture_cli.estimate.balance.motion import SmoothedLog
from capture_cli.estimate.balance.whitening import Whitening
from capture_cli.estimate.prepared_log import Balanced, PreparedLog
from capture_cli.log.input_sequences import HELD
from capture_cli.model.tasks.base import Task


def smoothed_log(prepared: PreparedLog, windows: np.ndarray) -> SmoothedLog | None:
    """The log in some `windows` (window,), smoothed; None where it gives no balance."""
    model, own = prepared.task.model, prepared.windows
    if model.neq or model.na:
        return None
    within = np.zeros(len(prepared.log.time), dtype=bool)
    for first, count in zip(own.first[windows], own.samples[windows], strict=True):
        within[first : first + count] = True
    try:
        return SmoothedLog.of(prepared.log.arrays, prepared.task, within & _between_stops(prepared))
    except LogError:
        return None


def timings_of_inputs(
    prepared: PreparedLog, threads: int | None
) -> tuple[tuple[InputTiming, ...], Balanced | None]:
    """How the inputs act of which the task does not say it, by what is not held out; none where there is no balance.
    With that balance, in which they are held.
    """
    task, windows = prepared.task, np.flatnonzero(~prepared.split.is_test)
    smoothed = smoothed_log(prepared, windows)
    if smoothed is None:
        return (), None
    try:
        balance, whitening = declared_balance(smoothed, task.space.nominal, threads)
    except LogError:  # too short
        return (), None
    rows = whitening.rows(by_parameter(balance))
    known = Balanced(windows, task.space.nominal, _where_sure(whitening, rows))
    names, holds = [c.name for c in task.inputs], [c.hold for c in task.inputs]
    found, nothing_else = input_timings(balance, whitening, rows, names, holds)
    return (tuple(found), known) if nothing_else else ((), known)


def balanced_point(
    prepared: PreparedLog, windows: np.ndarray, point: np.ndarray, threads: int | None
) -> np.ndarray | None:
    """Values (parameter,) of the declared parameters that fill the balance of some `windows` (window,) best, from
    `point` (parameter,) on; None where the log gives none, or where it leaves one of them open: along a ridge it would
    begin anywhere.
    """
    known, screening = prepared.balanced, prepared.screening
    if known is not None and known.is_of(windows, point):
        return known.point
    if screening is not None:
        whitening, rows = screening.whitening, screening.fits.by_parameter
    else:
        smoothed = smoothed_log(prepared, windows)
        if smoothed is None:
            return None
        try:
            balance, whitening = declared_balance(smoothed, point, threads)
        except LogError:  # too short
            return None
        rows = whitening.rows(by_parameter(balance))
    return _where_sure(whitening, rows)


def _where_sure(whitening: Whitening, rows: Sequence[np.ndarray]) -> np.ndarray | None:
    """The point (parameter,) of a balance; None where that leaves a parameter open. rows: of the parameters."""
    doubt = parameters_sd(whitening, rows)
    return whitening.balance.point if doubt.max(initial=0.0) < BALANCED_FITS.determined else None


def with_timings(task: Task, timings: Sequence[InputTiming]) -> Task:
    """The task with inputs that act as the log tells, and are held where it does not."""
    holds = {t.name: t.hold for t in timings}
    return task.with_holds(c.hold or holds.get(c.name, HELD) for c in task.inputs)


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
