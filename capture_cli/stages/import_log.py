"""`capture import-log`: CSV or Parquet files in, or other measured logs, one measured log out."""

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

import numpy as np

from capture_cli.common.documents import SETTINGS as DOCUMENTS
from capture_cli.common.documents import resolved
from capture_cli.common.frozen import frozen
from capture_cli.common.quantities import with_unit
from capture_cli.errors import LogError, first_of
from capture_cli.estimate.log_requirements import check_fits
from capture_cli.log.arrays import slices_until
from capture_cli.log.checks.equal_episodes import refuse_repeated
from capture_cli.log.checks.even_times import with_even_times
from capture_cli.log.checks.held_outputs import without_repeats
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.readers import open_source
from capture_cli.log.readers.base import SourceFile
from capture_cli.log.shorter_window import set_shorter
from capture_cli.log.windows import SETTINGS as WINDOWS
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.base import ActionTask, Task
from capture_cli.options.base import takes_options
from capture_cli.options.import_log import ImportLogOptions
from capture_cli.stages.recorded.recorded_task import task_inputs
from capture_cli.store.output import new_directory, refuse_existing, refuse_inputs, sha256
from capture_cli.store.provenance import Provenance
from capture_cli.store.writer_lock import only_writer


@frozen
class SETTINGS:
    least_steps: int = 2  # of an episode
    largest_plain: float = 1e16  # that Python writes without an exponent
    most_named: int = 6  # columns with holes
    few_turns: int = 5  # of time: episodes that begin, or files that were put together
    unsorted: float = 0.1  # of the rows: episodes are longer than ten
    mostly_still: float = 0.6  # of the rows have the time of the row before: it is written too coarsely
    coarse_time: float = 1e-4  # s: no times that a log needs are closer
    many_missing: float = 0.2  # of a column's values: hardly an accident


@takes_options
def import_log(options: ImportLogOptions) -> MeasuredLog:
    """Read the files, each a recording named by its stem, in their order, as channels of the task; write a log.

    Within a file a new episode begins where the value of the task's episode column changes. Of a task of actions, the
    columns action.NAME hold the action of each episode. A file may be a measured log as well. Each recording says what
    was mended: `dropped_rows`, `repeated_rows`, `held_repeats`, and `evened_times`, s. While episodes are appended
    nobody else adds to the log. A recording that is given twice, or that `out` holds already, is refused.
    Raises LogError, TaskError, ModelError, StoreError or OutputError before anything is written.
    """
    out, append = options.out, options.append
    refuse_existing(out, force=options.force or append)
    if not options.files:
        raise LogError("no file is given", cure="name one CSV or Parquet file or more")
    machine = load_task(options.task)
    sources = [open_source(Path(f), options.max_log_size) for f in options.files if not _is_store(Path(f))]
    refuse_inputs(out, [*options.files, *task_inputs(machine).values()])
    # who else adds to the log would put one without these episodes in its place
    with only_writer(out) if append and out.exists() else nullcontext():
        held = [MeasuredLog.read(out, options.max_log_size)] if append else []
        inputs = {"task": machine.path, **{str(f): Path(f) for f in options.files}}
        provenance = Provenance("import-log", options.recorded(), inputs)
        logs = _read(options, sources, machine)
        for log in [*held, *logs]:
            _check_task(log, machine)
        if options.drop_held:  # what is at `out` stays as it is
            logs = [without_repeats(log, machine) for log in logs]
        if options.even_times:
            logs = [with_even_times(log) for log in logs]
        refuse_repeated([*held, *logs])
        first, *others = [*held, *logs]
        log = first.followed_by(*others).check()
        _check_long_enough(log, machine)
        with new_directory(out, force=options.force or append) as folder:
            log.write(folder)
            provenance.write(folder)
    return replace(log, path=out)


def _read(options: ImportLogOptions, sources: Sequence[SourceFile], task: Task) -> list[MeasuredLog]:
    """The logs among the files in their order, and one of each run of the others, `sources`, between them."""
    names = _recording_names([s.path for s in sources])
    recordings = {s.path: _read_recording(s, n, task, options) for s, n in zip(sources, names, strict=True)}
    logs = []
    for stored, run in groupby(map(Path, options.files), key=_is_store):
        if stored:
            logs += [MeasuredLog.read(path, options.max_log_size) for path in run]
        else:
            first, *others = [recordings[path] for path in run]
            logs.append(first.followed_by(*others))
    return logs


def _is_store(path: Path) -> bool:
    return any((path / name).is_file() for name in ("zarr.json", ".zgroup"))


def _check_task(log: MeasuredLog, task: Task) -> None:
    if log.task != task.name:
        raise LogError(
            f"{log.path} belongs to the task {log.task!r}, and --task is {task.name!r}",
            cure="give the task it was made with, or another --out",
        )
    check_fits(log, task)


def _recording_names(files: Sequence[Path]) -> list[str]:
    """The stems, with as many folders before them as it takes to make them differ. Raises LogError."""
    places = [resolved(f) for f in files]
    if len(set(places)) < len(files):
        repeated = next(f for i, f in enumerate(files) if places[i] in places[:i])
        raise LogError(f"{repeated} is given twice", cure="give each file once")
    parts = [f.with_suffix("").parts for f in places]
    for count in range(1, max(map(len, parts), default=0) + 1):
        names = ["/".join(p[-count:]) for p in parts]
        if len(set(names)) == len(names):
            return names
    return [f.name for f in files]  # run.csv and run.parquet in one folder


@dataclass(frozen=True)
class _Steps:
    """What is read of a file: data (step, column), the first column of which is the time, and ends (episode,).

    columns: their names in the file. rows (step,): of the file, that they stand in.
    """

    source: SourceFile
    task: Task
    columns: Sequence[str]
    data: np.ndarray
    ends: np.ndarray
    rows: np.ndarray

    @property
    def time(self) -> np.ndarray:
        """(step,)."""
        return self.data[:, 0]

    @property
    def begins(self) -> np.ndarray:
        """The first steps of episodes (episode,)."""
        return np.array([0, *self.ends[:-1]])

    def place(self, step: int) -> str:
        """Where a step stands in the file, for a message."""
        return self.source.place(self.rows[step])

    def error(self, what: str, cure: str) -> LogError:
        return LogError(f"{self.source.path}: {what}", cure=cure)


def _read_recording(source: SourceFile, name: str, task: Task, options: ImportLogOptions) -> MeasuredLog:
    channels = (*task.inputs, *task.outputs)
    columns = [task.log.time, *(c.column for c in channels)]
    may_miss = np.array([False, *(c.sparse for c in channels)])
    source.require([*columns, *([task.log.episode] if task.log.episode else [])])
    data = _data(source, columns, task)
    actions = _actions(source, task)
    labels = _labels(source, len(data), task)
    sound = np.isfinite(data) | (np.isnan(data) & may_miss)
    unlabelled = np.array([label is None for label in labels], dtype=bool)
    if not options.drop_nan:
        _refuse_incomplete(source, columns, data, sound, unlabelled, task)
    rows = np.flatnonzero(sound.all(axis=1) & ~unlabelled)
    dropped = len(data) - len(rows)
    kept = rows if not options.drop_repeats else rows[~_repeats(data[rows], labels[rows])]
    repeated, rows = len(rows) - len(kept), kept
    data, labels = data[rows], labels[rows]
    if not len(data):
        raise LogError(
            f"{source.path}: not one of its {dropped} rows is complete",
            cure="correct the file, or leave it out",
        )
    ends = np.append(np.flatnonzero(labels[1:] != labels[:-1]) + 1, len(labels))
    steps = _Steps(source, task, columns, data, ends, rows)
    _check_episodes(steps)
    if actions is not None:
        actions = actions[rows]
        _check_one_action_each(steps, actions)
    _unwrap(steps)
    scale = np.array([task.log.time_scale, *(c.scale for c in channels)])
    offset = np.array([0.0, *(c.offset for c in channels)])
    with np.errstate(over="ignore"):
        steps = replace(steps, data=steps.data * scale + offset)
    _check_in_si(steps)
    described = {
        "name": name,
        "source": str(source.path),
        "sha256": sha256(source.path),
        "dropped_rows": dropped,
        "repeated_rows": repeated,
        "time_scale": task.log.time_scale,
        "comment_lines": source.comments,
        "cut_off": source.cut_off() if source.columns[-1] in columns else None,
        # an actuator and a sensor may have the same name
        "channels": {
            "inputs": {c.name: list(c.read_as) for c in task.inputs},
            "outputs": {c.name: list(c.read_as) for c in task.outputs},
        },
    }
    return MeasuredLog.of_recording(
        task,
        described,
        ends,
        time=steps.time,
        inputs=steps.data[:, 1 : 1 + len(task.inputs)],
        outputs=steps.data[:, 1 + len(task.inputs) :],
        actions=None if actions is None else actions[steps.begins],
        path=source.path,
        sparse=frozenset(c.name for c in task.outputs if c.sparse),
    )


def _data(source: SourceFile, columns: Sequence[str], task: Task) -> np.ndarray:
    """The columns as (row, column), the first of which is the time."""
    time, *others = columns
    since = source.times(time)
    if since is None:
        return source.numbers(columns)
    if task.log.time_scale != 1:
        raise LogError(
            f"{source.path}: column {time!r} holds times of day or dates, and [log] time_scale is "
            f"{task.log.time_scale:g}",
            cure="take time_scale out of the task.toml: such times are read as what they are, in seconds",
        )
    return np.column_stack([since, source.numbers(others)])


def _actions(source: SourceFile, task: Task) -> np.ndarray | None:
    """The columns action.NAME (row, action); None where there is none of them, or the task has no actions."""
    if not isinstance(task, ActionTask):
        return None
    columns = [f"action.{name}" for name in task.actions.names]
    if not set(columns) & set(source.columns):
        return None
    source.require(columns)
    values = source.numbers(columns)
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        row, k = bad[0]
        raise LogError(
            f"{source.path}: column {columns[k]!r} is missing or NaN at {source.place(row)}",
            cure="write the action of an episode into every row of it",
        )
    return values


def _refuse_incomplete(source: SourceFile, columns, data, sound, unlabelled, task: Task) -> None:
    """Raise LogError at the first row that lacks what it needs.

    sound (row, column): where data (row, column) may be what it is. unlabelled (row,): which episode is not said.
    """
    usable = sound.all(axis=1) & ~unlabelled
    if usable.all():
        return
    row = int(np.flatnonzero(~usable)[0])
    if unlabelled[row]:
        column, value = task.log.episode, "empty"
    else:
        bad = int(np.flatnonzero(~sound[row])[0])
        column, value = columns[bad], "missing or NaN" if np.isnan(data[row, bad]) else str(data[row, bad])
    raise LogError(
        f"{source.path}: column {column!r} is {value} at {source.place(row)} "
        f"({(~usable).sum()} of {len(data)} rows are incomplete{_holes(columns, ~sound)})",
        cure=_cure_of_missing(columns, np.isnan(data) & ~sound, task),
    )


def _holes(columns: Sequence[str], bad: np.ndarray) -> str:
    """How many values of each column are `bad` (row, column), where that is more than one column."""
    counts = dict(zip(columns, bad.sum(axis=0).tolist(), strict=True))
    having = [f"{name!r} in {n}" for name, n in sorted(counts.items(), key=lambda c: -c[1]) if n]
    if len(having) < 2:
        return ""
    return f": {first_of(having, SETTINGS.most_named)}"


def _cure_of_missing(columns: Sequence[str], missing: np.ndarray, task: Task) -> str:
    """What to do about values that are `missing` (row, column): of a slow sensor something else than of accidents."""
    counts = {name: int(n) for name, n in zip(columns, missing.sum(axis=0), strict=True)}
    rare = [name for name, n in counts.items() if n > SETTINGS.many_missing * len(missing)]
    said = []
    slow = [name for name in rare if name in {c.column for c in task.outputs}]
    if slow:
        keep = _as_sparse(slow, task) or "take its output out of the task"
        said.append(f"{_counted(slow, counts)}: if that is a sensor slower than the others, {keep}")
    driven = [name for name in rare if name in {c.column for c in task.inputs}]
    if driven:
        said.append(f"{_counted(driven, counts)}: write what was last commanded into every row")
    if said:
        return "; ".join([*said, "--drop-nan would leave the rows out, and with them what drove the machine"])
    return _cure_of_lost([name for name, n in counts.items() if n], task)


def _cure_of_lost(columns: Sequence[str], task: Task) -> str:
    """What to do about a few missing values of `columns`."""
    keep = _as_sparse(columns, task)
    if keep and set(columns) <= {c.column for c in task.outputs}:
        return f"{keep}, which keeps what drove the machine in such rows; or add --drop-nan to leave them out"
    return (
        "add --drop-nan to leave such rows out, with what drove the machine in them; or fill them in the file"
    )


def _counted(names: Sequence[str], counts: dict[str, int]) -> str:
    return ", ".join(f"{name!r} ({counts[name]} rows)" for name in names)


def _as_sparse(columns: Sequence[str], task: Task) -> str:
    """What to write into the task.toml so that `columns` may miss values; "" where it is built in, or reads none."""
    sensors = dict.fromkeys(task.model.sensor(c.sensor).name for c in task.outputs if c.column in columns)
    if task.path is None or not sensors:
        return ""
    return f"write sparse = true under {', '.join(f'[outputs.{name}]' for name in sensors)}"


def _repeats(data: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Which rows say the same as the row before, (row,): a logger that wrote twice."""
    same = np.zeros(len(data), dtype=bool)
    same[1:] = _alike(data[1:], data[:-1]) & (labels[1:] == labels[:-1])
    return same


def _alike(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Which rows of two arrays (row, column) are the same, missing values too, (row,)."""
    return ((a == b) | (np.isnan(a) & np.isnan(b))).all(axis=1)


def _labels(source: SourceFile, rows: int, task: Task) -> np.ndarray:
    """The episode column (row,), None where it is empty; the same in every row where there is no such column."""
    if task.log.episode is None:
        return np.zeros(rows, dtype=object)
    return np.array(source.labels(task.log.episode), dtype=object)


def _check_episodes(steps: _Steps) -> None:
    """Raise LogError where an episode has a single row, or its time stands still."""
    short = np.flatnonzero(steps.ends - steps.begins < SETTINGS.least_steps)
    if short.size:
        column = steps.task.log.episode
        raise steps.error(
            f"{short.size} of {len(steps.ends)} episodes have a single row, "
            f"the first at {steps.place(steps.begins[short[0]])}",
            cure="record longer, or remove those rows"
            if column is None
            else f"sort the rows by {column!r}, or correct [log] episode: an episode begins where it changes",
        )
    interval = np.diff(steps.time)
    interval[steps.ends[:-1] - 1] = np.inf  # from one episode to the next the clock may do what it likes
    back = np.flatnonzero(interval <= 0)
    if back.size:
        raise _not_increasing(steps, back)


def _check_one_action_each(steps: _Steps, actions: np.ndarray) -> None:
    """Raise LogError where an action (step, action) changes inside an episode: several episodes may have become one."""
    task, begins, ends = steps.task, steps.begins, steps.ends
    changed = np.argwhere(actions != np.repeat(actions[begins], ends - begins, axis=0))
    if changed.size:
        step, k = changed[0]
        begin = begins[np.searchsorted(ends, step, side="right")]
        name = f"action.{task.actions.names[k]}"
        raise steps.error(
            f"column {name!r} is {actions[begin, k]:.6g} at {steps.place(begin)} and "
            f"{actions[step, k]:.6g} at {steps.place(step)}, in one episode, which has one action",
            cure="part the episodes by a column, or write the action of an episode into every row of it"
            if task.log.episode is None
            else f"correct the column {task.log.episode!r}: an episode begins where it changes",
        )


def _unwrap(steps: _Steps) -> None:
    """Make outputs that begin anew after a period go on, in each episode."""
    data, task = steps.data, steps.task
    for k, channel in enumerate(task.outputs, start=1 + len(task.inputs)):
        if channel.period is not None:
            for episode in slices_until(steps.ends):
                sampled = episode.start + np.flatnonzero(~np.isnan(data[episode, k]))
                # by whole periods: an encoder's steps stay where they are
                turns = np.unwrap(data[sampled, k], period=channel.period) - data[sampled, k]
                data[sampled, k] += channel.period * np.rint(turns / channel.period)


def _not_increasing(steps: _Steps, back: np.ndarray) -> LogError:
    """The error for a time that does not increase after the steps `back`."""
    column = steps.task.log
    before, after = float(steps.time[back[0]]), float(steps.time[back[0] + 1])
    how = "stands still" if after == before else "goes back"
    here, there = steps.place(back[0] + 1), steps.place(back[0])
    unit = " s" if column.time_scale == 1 else ""  # as written in the file
    more = "" if back.size == 1 else f"; it happens {back.size} times"
    return steps.error(
        f"column {column.time!r} {how} at {here}: "
        f"{_written(after)}{unit} after {_written(before)}{unit} at {there}{more}",
        cure=_cure_of_times(steps, back),
    )


def _cure_of_times(steps: _Steps, back: np.ndarray) -> str:
    """What to do about a time that does not increase after the steps `back`."""
    time, task = steps.time, steps.task
    resolution = _lost_in_single_precision(time, task)
    if resolution is not None:
        unit = " s" if task.log.time_scale == 1 else ""
        return (
            f"the times have too few digits for their size: single precision (float32) tells times about {time[0]:.6g} "
            f"only {resolution:.4g}{unit} apart; export them in double precision, or from the start of the recording"
        )
    if _alike(steps.data[back], steps.data[back + 1]).all():
        return "add --drop-repeats: there the file has the same row twice"
    still = int((time[back + 1] == time[back]).sum())
    if still > SETTINGS.mostly_still * len(time):
        few = len(np.unique(time))
        return (
            f"the times have too few digits: the file's {len(time)} rows have {few} different one{'s' * (few > 1)}; "
            "write them with all their digits (a spreadsheet rounds long numbers: format that column as whole "
            "numbers), or from the start of the recording"
        )
    turns = back[time[back + 1] < time[back]]
    if len(turns) > max(SETTINGS.few_turns, SETTINGS.unsorted * len(time)):
        within = "" if task.log.episode is None else f", those of each {task.log.episode!r} by themselves"
        return f"the rows are not sorted by time: sort them{within}"
    before, after = time[back[0]], time[back[0] + 1]
    if task.log.episode is None and before - after > 0.5 * (before - time[0]):
        return (
            "if an episode begins there, name the column that tells episodes apart in [log] episode, "
            "or make it a file of its own"
        )
    return "remove repeated rows, and sort the others by time"


def _lost_in_single_precision(time: np.ndarray, task: Task) -> float | None:
    """How far times (step,) in single precision are apart, where they are and that is too far; None otherwise."""
    with np.errstate(over="ignore"):
        single = time.astype(np.float32)
    if not np.array_equal(single, time):
        return None
    resolution = float(np.spacing(np.abs(single).max()))
    interval = np.ptp(time) / max(len(time) - 1, 1)
    too_far = resolution > interval and resolution * task.log.time_scale > SETTINGS.coarse_time
    return resolution if too_far else None


def _written(time: float) -> str:
    """Nanoseconds since 1970 without an exponent, as a file has them but for their last digits."""
    return f"{time:.0f}" if time.is_integer() and abs(time) >= SETTINGS.largest_plain else repr(time)


def _check_in_si(steps: _Steps) -> None:
    """Raise LogError where one of the data overflows, or is too large to be measured."""
    bad = np.argwhere(np.isinf(steps.data))
    if bad.size:
        step, k = bad[0]
        raise steps.error(
            f"scale * column + offset overflows for {steps.columns[k]!r} at {steps.place(step)}",
            cure="correct the value, or scale and offset in the task.toml",
        )
    huge = np.argwhere(np.abs(steps.data[:, 1:]) > DOCUMENTS.largest)  # a time may be
    if not huge.size:
        return
    step, k = huge[0]
    channel = (*steps.task.inputs, *steps.task.outputs)[k]
    scaled = with_unit(f"{steps.data[step, 1 + k]:.4g}", channel.unit)
    raise steps.error(
        f"column {channel.column!r} comes to {scaled} at {steps.place(step)} "
        f"({len(huge)} such values), too large to be a measurement: {DOCUMENTS.largest:g} is the most",
        cure="correct the value, or scale and offset in the task.toml; if it marks what was not measured, leave the "
        "cell empty and add --drop-nan",
    )


def _check_long_enough(log: MeasuredLog, task: Task) -> None:
    longest, window = log.longest, task.log.window
    if window is not None and longest < WINDOWS.shortest_episode * window:
        raise LogError(
            f"the longest episode lasts {longest:.3g} s, which is shorter than a window of {window:g} s",
            cure=f"{set_shorter(longest, log.steps_of_longest, option=False)}; if the time column is not in seconds, "
            "give [log] time_scale, the seconds in one unit of it",
        )
