"""Sample-and-hold: outputs of a slow sensor whose last value a logger repeats until the next."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.errors import LogError
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.quantisation import distinct
from capture_cli.model.tasks.base import Task


@frozen
class SETTINGS:
    fewest_runs: int = 20  # of equal values: fewer may be of one length by accident
    # of the runs, at least, are nearly of one length: those of a coarse sensor follow the speed
    regular: float = 0.9
    least_run: int = 2  # a speed made of counts is 0 for some rows and something else in single ones
    slack: float = 0.1  # of that length, and a row at least, is what a clock of its own makes of a run
    one_step: float = 1.5  # steps: a change smaller than this is of one
    mostly: float = 0.5  # of the changes


def rows_per_sample(values: np.ndarray, episodes: Sequence[slice]) -> float | None:
    """For how many rows an output (step,), or a sensor (step, value), holds each sample; None where it does not.

    A sensor that is coarse holds its value too, but for as long as it takes to move by one of its steps.
    """
    columns = values.reshape(len(values), -1)
    runs = np.concatenate([np.diff(_changes(columns[e])) for e in episodes] or [np.empty(0, dtype=int)])
    if len(runs) < SETTINGS.fewest_runs:
        return None
    usual = float(np.median(runs))
    regular = runs[(np.abs(runs - usual) <= max(1.0, SETTINGS.slack * usual)) & (runs >= SETTINGS.least_run)]
    if len(regular) < SETTINGS.regular * len(runs):
        return None
    if all(_moves_by_single_steps(column, episodes) for column in columns.T):
        return None
    return float(regular.mean())


def sample_rate(time: np.ndarray, episodes: Sequence[slice], rows: float) -> float | None:
    """Hz, of a sample held for `rows` rows of the times (step,), s; None where time does not go forward."""
    with np.errstate(invalid="ignore"):
        interval = np.concatenate([np.diff(time[e]) for e in episodes])
        interval = interval[(interval > 0) & np.isfinite(interval)]
    return float(1 / (rows * np.median(interval))) if len(interval) else None


def without_repeats(log: MeasuredLog, task: Task) -> MeasuredLog:
    """The log with NaN where an output holds a sample: each is left in the row where it first appears.

    The run that an episode begins with has none where it is too short to show where its sample appeared. Of a sensor
    with several values, those rows are emptied in which all are held. `held_repeats` of each recording says how many
    samples were.
    Raises LogError where an output that is held is not sparse in the task.
    """
    sensors = np.array([c.sensor for c in task.outputs])
    outputs, emptied = log.outputs.copy(), np.zeros(len(log.time), dtype=int)
    not_sparse = []
    for sensor in dict.fromkeys(sensors.tolist()):
        own = np.flatnonzero(sensors == sensor)
        steps = np.flatnonzero(log.sampled[:, own].all(axis=1))
        values, episodes = log.outputs[np.ix_(steps, own)], slices_within(steps, log.episodes)
        rows = rows_per_sample(values, episodes)
        if rows is None:
            continue
        if not all(task.outputs[k].sparse for k in own):
            not_sparse.append(task.model.sensor(sensor).name)
            continue
        held = steps[np.concatenate([_held(values[e], rows) for e in episodes])]
        outputs[np.ix_(held, own)] = np.nan
        emptied[held] += 1
    if not_sparse:
        raise _not_sparse(not_sparse, log, task)
    number = np.repeat(log.recording, np.diff(log.episode_ends, prepend=0))
    counts = np.bincount(number, weights=emptied, minlength=len(log.recordings)).astype(int).tolist()
    recordings = tuple({**r, "held_repeats": n} for r, n in zip(log.recordings, counts, strict=True))
    sparse = log.sparse | {c.name for c in task.outputs if c.sparse}
    return replace(log, outputs=outputs, recordings=recordings, sparse=sparse)


def slices_within(steps: np.ndarray, episodes: Sequence[slice]) -> list[slice]:
    """The episodes as slices of the log's `steps` (sample,)."""
    edges = np.searchsorted(steps, [(e.start, e.stop) for e in episodes])
    return [slice(int(a), int(b)) for a, b in edges]


def _changes(columns: np.ndarray) -> np.ndarray:
    """The steps at which a value of (step, value) is another than before, (change,)."""
    return 1 + np.flatnonzero((columns[1:] != columns[:-1]).any(axis=1))


def _held(columns: np.ndarray, rows: float) -> np.ndarray:
    """Which of the samples (sample, value) of an episode are repeats, (sample,)."""
    held = np.ones(len(columns), dtype=bool)
    changes = _changes(columns)
    held[changes] = False
    first_run = changes[0] if len(changes) else len(columns)
    if len(columns) and first_run > rows - 0.5:
        held[0] = False
    return held


def _moves_by_single_steps(values: np.ndarray, episodes: Sequence[slice]) -> bool:
    """Whether most changes of values (step,) are the least there is, as a coarse sensor's are; or there is none."""
    levels = np.unique(values[np.isfinite(values)])
    if len(levels) < 2:
        return True
    step = np.diff(distinct(levels)).min()
    with np.errstate(invalid="ignore"):
        change = np.abs(np.concatenate([np.diff(values[e]) for e in episodes]))
    change = change[change > 0]
    return bool(np.mean(change < SETTINGS.one_step * step) > SETTINGS.mostly)


def _not_sparse(sensors: Sequence[str], log: MeasuredLog, task: Task) -> LogError:
    tables = ", ".join(f"[outputs.{name}]" for name in sensors)
    return LogError(
        f"{log.path}: --drop-held would empty cells of {', '.join(map(repr, sensors))}, which task {task.name!r} wants "
        "in every row",
        cure=f"write sparse = true under {tables}"
        if task.path
        else "leave the option out: outputs of a task that is built in cannot be sparse",
    )
