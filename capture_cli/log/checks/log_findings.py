"""What is wrong, or worth knowing, with a measured log: each finding has a severity, a place, and a cure.

Severities: "error", the log cannot be used as it is; "warning", results will suffer; "note", good to know.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from capture_cli.common.quantities import percent, with_unit
from capture_cli.errors import LONGEST, LONGEST_CURE, cut
from capture_cli.log.measured_log import FEWEST_OF_A_SPARSE, LARGEST, MeasuredLog
from capture_cli.model.tasks.base import Channel, Task
from capture_cli.sim.contacts import can_touch
from capture_cli.sim.quaternion_order import W_FIRST, W_LAST, is_w_last, order_in_names
from capture_cli.sim.quaternion_signs import quaternion_columns
from capture_cli.sim.sensor_units import unit_in_name
from capture_cli.sim.shorter_window import set_shorter
from capture_cli.sim.step_length import unsuitable_step
from capture_cli.sim.windows import SHORTEST_EPISODE

Finding = dict[str, str]

UNEVEN = 0.1  # sd of the interval, over its median
SATURATED = 0.05  # share of the samples at exactly one extreme
SEVERAL_VISITS = 3  # a channel that returns to exactly the same extreme is held there by something
PILED_UP = 5.0  # times the share at the values next to an extreme: a quantised sine has 3
MANY_LEVELS = 10  # fewer are a switched signal, which is at its extremes by design
MOSTLY_AT_REST = 0.5
WINDOW_SAMPLES = 5  # fewer in a window say little
TURN_SLACK = 1.0  # rad that a hinge moves between two samples, beside a jump by a turn
RANGE_SLACK = 0.05  # of a joint's range
ROUNDED = 1e-6  # of an actuator's range: numbers in files are rounded
LEAST_IN_MS = 0.1  # s, between samples: times in ms of a sensor that reports at 10 kHz
LONG_INTERVAL = 0.5  # s, between samples, at most, if a unit of time is to be taken for theirs
SMALL_UNITS = {"ms": "1e-3", "us": "1e-6", "ns": "1e-9"}  # as a task.toml has them
EXAMPLES = 3
DEGREES = 180 / np.pi
LIKE_DEGREES = 0.1  # of that factor, is how near to it the one between two channels is
ALIKE = 0.95  # correlation of two channels that show the same motion


def finding(severity: str, where: str, message: str, cure: str) -> Finding:
    """severity: "error", "warning" or "note". where: the channel, recording or file. cure: what to do."""
    shown = (cut(message, LONGEST - LONGEST_CURE), cut(cure, LONGEST_CURE))
    return {"severity": severity, "where": where, "message": shown[0], "cure": shown[1]}


def log_findings(document: Mapping[str, Any], task: Task | None = None) -> list[Finding]:
    """Findings on the `episodes` and `channels` of an inspection document. task: theirs, where it is known."""
    episodes = document["episodes"]
    return [
        *_timing(episodes, document["time_scatter"]),
        *_scatter(document["time_scatter"], document["channels"]),
        *(f for c in document["channels"] for f in _values(c, len(episodes))),
        *(f for c in document["channels"] if c["kind"] == "input" for f in _input(c)),
        *(f for c in document["channels"] if c["kind"] == "output" for f in _output(c, task)),
        *_held([c for c in document["channels"] if c.get("held")], task),
    ]


def task_findings(log: MeasuredLog, document: Mapping[str, Any], task: Task) -> list[Finding]:
    """Findings on whether `log`, with its inspection document, fits `task`."""
    found = list(_names(log, task))
    if any(f["severity"] == "error" for f in found):
        return found
    return [
        *found,
        *_shared_columns(task),
        *_units_in_names(task),
        *_quaternion_order(log, task),
        *_lengths(document["episodes"], task),
        *_ranges(log, task),
        *_turns(log, task),
        *_degrees(log, task),
    ]


# --- timing ---


def _timing(episodes: Sequence[Mapping[str, Any]], scatter: Mapping[str, Any] | None) -> Iterator[Finding]:
    for key, what in (("backward_times", "goes back"), ("repeated_times", "stands still")):
        count, where, examples = _gather(
            episodes, key, lambda p: f"after {p['time']:.6g} s (step {p['step']})"
        )
        if count:
            yield finding(
                "error",
                where,
                f"time {what} in {count} place{'s' * (count > 1)}: {examples}",
                "sort the rows by time, remove repeated ones, and import the files again; where an episode "
                "begins, name the column that tells episodes apart in [log] episode",
            )
    count, where, examples = _gather(
        episodes, "gaps", lambda p: f"{p['interval']:.3g} s after {p['time']:.6g} s"
    )
    if count:
        yield finding(
            "warning",
            where,
            f"{count} gap{'s' * (count > 1)} in the sampling: {examples}",
            "windows end at a gap, so nothing needs doing; look for lost messages if there are many",
        )
    uneven = [e for e in episodes if e["jitter_sd"] is not None and e["jitter_sd"] > UNEVEN]
    if uneven and scatter is None:
        worst = max(uneven, key=lambda e: e["jitter_sd"])
        yield finding(
            "note",
            _episode(worst) if len(uneven) == 1 else f"{len(uneven)} episodes",
            f"sampling is uneven: the interval's sd is {percent(worst['jitter_sd'])} of its median, "
            f"the longest is {worst['jitter_max']:.3g} times the median",
            "nothing to do: every sample is compared at its own time, and a model's step takes the mean of its inputs",
        )


def _scatter(scatter: Mapping[str, Any] | None, channels: Sequence[Mapping[str, Any]]) -> Iterator[Finding]:
    """Stamps that scatter about even times at which outputs are smoother."""
    if scatter is None:
        return
    own = {c["name"]: c for c in channels if c["kind"] == "output"}
    smoother = [
        f"{name} has a noise of {_in_unit(there, own[name])} there, and {_in_unit(here, own[name])} at its stamps"
        for name, (here, there) in scatter["smoother"].items()
    ]
    yield finding(
        "warning",
        "time",
        f"stamps scatter by {1e3 * scatter['sd']:.3g} ms (sd) about even times: {_listed(smoother, len(smoother))}",
        "import the files again with --even-times, or stamp samples where they are measured and not where they arrive",
    )


def _gather(episodes, key: str, describe) -> tuple[int, str, str]:
    """How many over all episodes, where, and the first few described."""
    having = [e for e in episodes if e[key]["count"]]
    count = sum(e[key]["count"] for e in having)
    places = [describe(p) for e in having for p in e[key]["first"]][:EXAMPLES]
    where = _episode(having[0]) if len(having) == 1 else f"{len(having)} episodes"
    return count, where, _listed(places, count)


def _episode(episode: Mapping[str, Any]) -> str:
    return f"{episode['recording']}, episode {episode['episode']}"


def _listed(items: Iterable[Any], count: int) -> str:
    items = [str(i) for i in items][:EXAMPLES]
    rest = count - len(items)
    return ", ".join(items) + (f" and {rest} more" if rest else "")


# --- values ---


def _in_unit(value: float, channel: Mapping[str, Any], digits: int = 3) -> str:
    """A value of the channel, before its unit if it has one."""
    return with_unit(f"{value:.{digits}g}", channel["unit"])


def _values(channel: Mapping[str, Any], episodes: int) -> Iterator[Finding]:
    where, is_input = f"{channel['kind']} {channel['name']}", channel["kind"] == "input"
    bad = channel["nan"] + channel["infinite"]
    if bad:
        steps = _listed((f"step {i}" for i in channel["bad_steps"]), bad)
        yield finding(
            "error",
            where,
            f"{bad} values are NaN, infinite or beyond {LARGEST:g}: {steps}",
            "import the files again with --drop-nan, or correct them in the source",
        )
    sampling = channel.get("sampling")
    if sampling is not None and sampling["fewest"] < FEWEST_OF_A_SPARSE:
        yield finding(
            "error",
            where,
            f"is sparse, and an episode has {sampling['fewest']} samples of it; {FEWEST_OF_A_SPARSE} are needed",
            "check its column; leave that episode out, record longer, or take the output out of the task.toml",
        )
    if channel["constant"]:
        yield finding(
            "warning" if is_input else "error",
            where,
            f"never changes: always {_in_unit(channel['low']['value'], channel, 6)}",
            "check its column if something drives it; excite this input if its parameters matter"
            if is_input
            else "check the sensor and its column, or leave the output out of the task.toml",
        )
        return
    still = channel["constant_episodes"]
    if still:
        yield finding(
            "note" if is_input else "warning",
            where,
            f"never changes in {len(still)} of {episodes} episodes: {_listed(still, len(still))}",
            "nothing to do, if the machine stood still there; otherwise leave those episodes out",
        )


def _input(channel: Mapping[str, Any]) -> Iterator[Finding]:
    where, moves = f"input {channel['name']}", channel["excitation"]
    for extreme in _extremes(channel):
        if extreme["value"] != 0:
            yield finding(
                "warning" if extreme["visits"] >= SEVERAL_VISITS else "note",
                where,
                f"is at exactly {_in_unit(extreme['value'], channel, 6)} for {percent(extreme['share'])} "
                f"of the samples, in {extreme['visits']} stays: saturated, or held?",
                "nothing to do if this is what reached the actuator; if it is what was asked of it, log the former",
            )
    if moves["at_rest"] is not None and moves["at_rest"] > MOSTLY_AT_REST and not channel["constant"]:
        yield finding(
            "note",
            where,
            f"is at rest (near 0) for {percent(moves['at_rest'])} of the samples",
            "excite it for longer if intervals come out wide",
        )
    if moves["single_frequency"] is not None:
        yield finding(
            "warning",
            where,
            f"changes at a single frequency, {moves['single_frequency']:.3g} Hz",
            "one frequency cannot tell inertia from stiffness: use several, steps, or a sweep",
        )


def _extremes(channel: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The ends of a channel's range at which it is suspiciously often."""
    if channel["levels"] <= MANY_LEVELS:
        return []
    ends = [channel["low"], channel["high"]]
    return [e for e in ends if e["share"] > SATURATED and e["share"] > PILED_UP * e["neighbours"]]


def _output(channel: Mapping[str, Any], task: Task | None) -> Iterator[Finding]:
    where, grid = f"output {channel['name']}", channel["quantisation"]
    for extreme in _extremes(channel):
        if extreme["visits"] >= SEVERAL_VISITS:
            yield finding(
                "warning",
                where,
                f"is at exactly {_in_unit(extreme['value'], channel, 6)} for {percent(extreme['share'])} "
                f"of the samples, in {extreme['visits']} stays: the sensor's range, or an end stop?",
                "leave those episodes out if the sensor clips; put a stop into the model",
            )
    moves_less = grid["step"] is not None and grid["change"] is not None and grid["change"] <= grid["step"]
    if moves_less and channel["held"] is None:  # of one that repeats its samples most changes are 0
        yield finding(
            "note",
            where,
            f"is quantised in steps of {_in_unit(grid['step'], channel)} "
            f"(sd {grid['step'] / np.sqrt(12):.2g}), and moves less than that from sample to sample",
            "nothing to do: the noise floor will show it",
        )
    out = channel["spikes"]
    if out["count"]:
        count = out["count"]
        ends = f" ({out['ends']} of them at an end of an episode)" if out["ends"] else ""
        yield finding(
            "warning",
            where,
            f"{count} single sample{'s stand' if count > 1 else ' stands'} out, by up to "
            f"{_in_unit(out['largest'], channel)}: {_listed((f'step {i}' for i in out['first']), count)}{ends}",
            _cure_of_spikes(task, all_at_ends=out["ends"] == count),
        )


def _held(channels: Sequence[Mapping[str, Any]], task: Task | None) -> Iterator[Finding]:
    """Outputs that repeat each sample for some rows, those of one sensor together where the task is known."""
    sensors = {} if task is None else {c.name: _sensor(c, task) for c in task.outputs}
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for channel in channels:
        groups.setdefault(sensors.get(channel["name"], channel["name"]), []).append(channel)
    for sensor, own in groups.items():
        fastest = min(own, key=lambda c: c["held"]["rows"])
        rows, rate = fastest["held"]["rows"], fastest["held"]["rate"]
        how_often = "" if rate is None else f": {rate:.3g} times per second, of {rate * rows:.3g} rows"
        yield finding(
            "warning",
            f"output {sensor if len(own) > 1 else fastest['name']}",
            f"changes only every {rows:.3g} rows{how_often}; between its samples it repeats the last one",
            _cure_of_held(fastest, sensor, task),
        )


def _sensor(output: Channel, task: Task) -> str:
    return task.model.sensor(output.sensor).name


def _cure_of_held(channel: Mapping[str, Any], sensor: str, task: Task | None) -> str:
    """What to do about an output of `sensor` that repeats each sample until the next."""
    again = "import the files again with --drop-held: each sample stays in the row where it first appears"
    if channel.get("sampling"):  # sparse already
        return again
    if task is not None and task.path is None:  # its outputs are what they are
        return "leave out the rows in which it repeats: a repeat is late, and looks like noise or a delay"
    return f"write sparse = true under [outputs.{sensor}], and {again}"


def _cure_of_spikes(task: Task | None, *, all_at_ends: bool) -> str:
    """What to do about single samples that stand out."""
    keep = "keep them where bodies hit each other, which looks like this; otherwise "
    empty = "leave these values empty in the source, write sparse = true under the output and import again"
    if task is not None and task.path is None:  # its outputs are what they are
        empty = "leave these values empty in the source and import with --drop-nan"
    if all_at_ends:
        empty = "remove these rows from the source, as a line that was cut off, and import again"
    return (
        f"{keep if task is not None and can_touch(task.model) else ''}{empty}: errors count by their squares"
    )


# --- against a task ---


def _names(log: MeasuredLog, task: Task) -> Iterator[Finding]:
    if log.task != task.name:
        yield finding(
            "warning",
            "task",
            f"the log was made for the task {log.task!r}, and --task is {task.name!r}",
            "give the task it was made with, or import the files again with this one",
        )
    for kind, names, units, channels in (
        ("inputs", log.input_names, log.input_units, task.inputs),
        ("outputs", log.output_names, log.output_units, task.outputs),
    ):
        yield from _channel_names(kind, names, units, channels, task.name)
    made_sparse = (_sensor(c, task) for c in task.outputs if c.name in log.sparse and not c.sparse)
    for sensor in dict.fromkeys(made_sparse):
        yield finding(
            "error",
            f"output {sensor}",
            f"the log has it as sparse, and task {task.name!r} does not",
            f"write sparse = true under [outputs.{sensor}]",
        )


def _channel_names(kind: str, names, units, channels: Sequence[Channel], task: str) -> Iterator[Finding]:
    expected = tuple(c.name for c in channels)
    again = "import the files again with this task"
    if tuple(names) != expected:
        message = f"the log has ({', '.join(names)}); task {task!r} has ({', '.join(expected)})"
        yield finding("error", kind, message, again)
        return
    for c, unit in zip(channels, units, strict=True):
        if unit != c.unit:
            message = f"the log has it in {unit!r}, task {task!r} in {c.unit!r}"
            yield finding("error", f"{kind[:-1]} {c.name}", message, again)


def _shared_columns(task: Task) -> Iterator[Finding]:
    """Channels that read a column which another reads, too."""
    driving: dict[str, Channel] = {}
    for channel in task.inputs:
        if driving.setdefault(channel.column, channel) is not channel:
            yield finding(
                "warning",
                f"input {channel.name}",
                f"reads column {channel.column!r}, as input {driving[channel.column].name} does",
                "nothing to do if one command drives both; otherwise give each its column, and import the files again",
            )
    readers = {c.column: ("input", c) for c in reversed(task.inputs)}
    for output in task.outputs:
        kind, first = readers.setdefault(output.column, ("output", output))
        if first is not output:
            why = "what drives the machine is no measurement of it" if kind == "input" else "it counts twice"
            yield finding(
                "warning",
                f"output {output.name}",
                f"reads column {output.column!r}, as {kind} {first.name} does: {why}",
                "give the column that this output is measured by, or remove it, and import the files again",
            )


def _lengths(episodes: Sequence[Mapping[str, Any]], task: Task) -> Iterator[Finding]:
    known = [e for e in episodes if e["duration"] is not None]
    intervals = [e["interval"] for e in episodes if e["interval"] is not None]
    if not known or not intervals:
        return
    longest = max(known, key=lambda e: e["duration"])
    window, interval = task.log.window, float(np.median(intervals))
    if window is not None and longest["duration"] < SHORTEST_EPISODE * window:
        yield finding(
            "error",
            "episodes",
            f"the longest lasts {longest['duration']:.3g} s, and a window {window:g} s",
            set_shorter(longest["duration"], longest["steps"], option=True),
        )
    elif window is not None and window < WINDOW_SAMPLES * interval:
        yield finding(
            "warning",
            "time",
            f"a window of {window:g} s holds {window / interval:.2g} samples, {interval:.3g} s apart",
            f"set a longer [log] window{_time_unit(interval, task.log.time_scale)}",
        )
    unsuitable = unsuitable_step(task.timestep, interval, longest["duration"] if window is None else window)
    if unsuitable is not None:
        yield finding("error", "time", *unsuitable)
    elif task.timestep > 1.001 * interval:
        yield finding(
            "warning",
            "time",
            f"the model steps by {task.timestep:g} s, coarser than the log's {interval:.3g} s",
            "set a smaller timestep in the model's <option>",
        )


def _time_unit(interval: float, time_scale: float) -> str:
    """What else to do about samples so many seconds apart: their times may be in another unit."""
    if time_scale != 1:
        return f"; if one unit of time is not {time_scale:g} s, correct [log] time_scale, and import the files again"
    if interval < LEAST_IN_MS:
        return ""
    short = (u for u, scale in SMALL_UNITS.items() if interval * float(scale) < LONG_INTERVAL)
    unit = next(short, "ns")
    return (
        f"; if the time column is in {unit}, write time_scale = {SMALL_UNITS[unit]} under [log] and import the files "
        "again"
    )


def _ranges(log: MeasuredLog, task: Task) -> Iterator[Finding]:
    """Inputs that MuJoCo would clip, and joint positions outside the joint's range."""
    model = task.model
    for k, c in enumerate(task.inputs):
        if model.actuator_ctrllimited[c.index]:
            share, low, high = _outside(log.inputs[:, k], model.actuator_ctrlrange[c.index], slack=ROUNDED)
            if share:
                yield finding(
                    "warning",
                    f"input {c.name}",
                    f"{percent(share, 1)} of the samples are outside ctrlrange ({low:g}, {high:g}): MuJoCo clips",
                    "widen ctrlrange in the model, or correct scale and offset",
                )
    sampled = log.sampled
    for k, c in enumerate(task.outputs):
        joint = int(model.sensor_objid[c.sensor])
        is_position = model.sensor_type[c.sensor] == mujoco.mjtSensor.mjSENS_JOINTPOS
        if is_position and model.jnt_limited[joint]:
            share, low, high = _outside(
                log.outputs[sampled[:, k], k], model.jnt_range[joint], slack=RANGE_SLACK
            )
            if share:
                yield finding(
                    "warning",
                    f"output {c.name}",
                    f"{percent(share, 1)} of the samples lie outside the joint's range ({low:g}, {high:g})",
                    "check scale and offset (degrees, another zero?), or the joint's range",
                )


def _units_in_names(task: Task) -> Iterator[Finding]:
    """Columns whose name ends in another unit than they are read in, with no scale."""
    columns = [
        *((f"input {c.name}", c.column, c.unit, c.scale) for c in task.inputs),
        *((f"output {c.name}", c.column, c.unit, c.scale) for c in task.outputs),
        ("time", task.log.time, "s", task.log.time_scale),
    ]
    for where, column, unit, scale in columns:
        named = unit_in_name(column, unit) if scale == 1 else None
        if named:
            written, factor = named
            key = f"[log] time_scale = {factor:.8g}" if where == "time" else f'column_unit = "{written}"'
            yield finding(
                "warning",
                where,
                f"column {column!r} is read as {unit}, and its name ends in {written}",
                f"write {key} if it is in {written}, and import again",
            )


def _quaternion_order(log: MeasuredLog, task: Task) -> Iterator[Finding]:
    """Attitudes whose columns are not w, x, y, z, by their names or, where these say nothing, by their values."""
    if task.path is None:  # its columns are what they are
        return
    for own in quaternion_columns(task.model, [c.sensor for c in task.outputs]):
        sensor, columns = task.outputs[own[0]].sensor, [task.outputs[k].column for k in own]
        order, said = order_in_names(columns), ", and their names say {}"
        if order is None:
            values = log.outputs[np.ix_(log.sampled[:, own].all(axis=1), own)]
            order = W_LAST if is_w_last(values, task.model, sensor) else W_FIRST
            said = ": so the body is half a turn from upright throughout, and as {} it stays upright"
        if order != W_FIRST:
            found = ", ".join("wxyz"[order.index(k)] for k in range(4))
            mended = ", ".join(f'"{columns[k]}"' for k in order)
            yield finding(
                "warning",
                f"output {task.model.sensor(sensor).name}",
                f"its columns, {', '.join(columns)}, are read as w, x, y, z{said.format(found)}",
                f"write column = [{mended}] if that is their order, and import the files again",
            )


def _turns(log: MeasuredLog, task: Task) -> Iterator[Finding]:
    """Angles of hinges that begin anew after a whole turn, as a heading from -180 to 180 degrees does."""
    model = task.model
    episode = np.searchsorted(log.episode_ends, np.arange(len(log.time)), side="right")
    for k, c in enumerate(task.outputs):
        if model.sensor_type[c.sensor] != mujoco.mjtSensor.mjSENS_JOINTPOS:
            continue
        if model.jnt_type[model.sensor_objid[c.sensor]] != mujoco.mjtJoint.mjJNT_HINGE:
            continue
        own = np.flatnonzero(log.sampled[:, k])
        together = episode[own[1:]] == episode[own[:-1]]
        with np.errstate(invalid="ignore"):
            steps = np.abs(np.diff(log.outputs[own, k]))[together]
            jumps = np.abs(steps - 2 * np.pi) < TURN_SLACK
        if jumps.any() and np.median(steps) < TURN_SLACK:
            count = int(jumps.sum())
            yield finding(
                "warning",
                f"output {c.name}",
                f"jumps by a whole turn in {count} place{'s' * (count > 1)}, and the angle of a hinge does not",
                f"write period = {2 * np.pi / abs(c.scale):.6g} under [outputs.{c.name}] and import again",
            )


def _degrees(log: MeasuredLog, task: Task) -> Iterator[Finding]:
    """Angles of hinges that are 57.3 times, or a 57.3th of, what another channel says of the same motion; or go against
    it.
    """
    for k, c, joint in _hinge_outputs(task, mujoco.mjtSensor.mjSENS_JOINTPOS):
        angle = log.outputs[:, k]
        others = [
            (f"output {o.name}", "the integral of ", _integral(log.outputs[:, i], log))
            for i, o, of in _hinge_outputs(task, mujoco.mjtSensor.mjSENS_JOINTVEL)
            if of == joint
        ]
        others += [
            (f"input {i.name}", "", log.inputs[:, n])
            for n, i in enumerate(task.inputs)
            if _follows(task.model, i.index, joint)
        ]
        for name, how, reference in others:
            likeness, factor = _likeness(angle, reference, log.episodes)
            if likeness < -ALIKE:
                yield finding(
                    "warning",
                    f"output {c.name}",
                    f"goes down where {how}{name} goes up: does one of them count the other way?",
                    "write a negative scale under the one that does, and import again",
                )
            if (
                abs(likeness) < ALIKE
                or min(abs(factor * DEGREES - 1), abs(factor / DEGREES - 1)) > LIKE_DEGREES
            ):
                continue
            large, small = (f"output {c.name}", name) if factor > 1 else (name, f"output {c.name}")
            degrees = "deg/s" if how and large == name else "deg"
            yield finding(
                "warning",
                f"output {c.name}",
                f"moves {factor:.3g} times as far as {how}{name} says: is {large} in degrees, and {small} in rad?",
                f'write column_unit = "{degrees}" under {large}, as the model is in rad, and import again',
            )


def _hinge_outputs(task: Task, kind: mujoco.mjtSensor) -> Iterator[tuple[int, Channel, int]]:
    """Outputs of sensors of `kind` at hinges: which, the channel, and the joint."""
    model = task.model
    for k, c in enumerate(task.outputs):
        joint = int(model.sensor_objid[c.sensor])
        if model.sensor_type[c.sensor] == kind and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
            yield k, c, joint


def _follows(model: mujoco.MjModel, actuator: int, joint: int) -> bool:
    """Whether the actuator is a servo that brings the joint to where its control says."""
    at_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
    gain, back = model.actuator_gainprm[actuator, 0], model.actuator_biasprm[actuator, 1]
    return bool(
        at_joint
        and model.actuator_trnid[actuator, 0] == joint
        and model.actuator_gear[actuator, 0] == 1
        and gain == -back != 0
    )


def _integral(speed: np.ndarray, log: MeasuredLog) -> np.ndarray:
    """Of an output (step,) over the time of each episode, by trapezoids."""
    grown = np.zeros(len(speed))
    for e in log.episodes:
        grown[e][1:] = np.cumsum(np.diff(log.time[e]) * (speed[e][1:] + speed[e][:-1]) / 2)
    return grown


def _likeness(values: np.ndarray, reference: np.ndarray, episodes: Sequence[slice]) -> tuple[float, float]:
    """Correlation of `values` (step,) with `reference` within episodes, and how many times as far they go.

    0 and 1 where samples lack or nothing moves.
    """
    both = np.stack([values, reference])
    moves = np.concatenate([both[:, e] - both[:, e].mean(axis=1, keepdims=True) for e in episodes], axis=1)
    with np.errstate(invalid="ignore", over="ignore"):
        (own, cross), (_, theirs) = moves @ moves.T
    if not (np.isfinite([own, cross, theirs]).all() and own > 0 and theirs > 0):
        return 0.0, 1.0
    return float(cross / np.sqrt(own) / np.sqrt(theirs)), float(np.sqrt(own / theirs))


def _outside(values: np.ndarray, limits: np.ndarray, *, slack: float) -> tuple[float, float, float]:
    """Share of `values` (step,) farther outside `limits` (2,) than `slack` of their span, and the limits."""
    low, high = map(float, limits)
    margin = slack * (high - low)
    if not len(values):
        return 0.0, low, high
    with np.errstate(invalid="ignore"):
        return float(np.mean((values < low - margin) | (values > high + margin))), low, high
