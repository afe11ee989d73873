"""What is wrong, or worth knowing, with a measured log: each finding has a severity, a place, and a cure.

Severities: "error", the log cannot be used as it is; "warning", results will suffer; "note", good to know.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from capture_cli.common.documents import SETTINGS as DOCUMENTS
from capture_cli.common.frozen import frozen
from capture_cli.common.quantities import percent, with_unit
from capture_cli.errors import first_of
from capture_cli.log.checks import in_order
from capture_cli.log.checks.base import Finding, Inspected, error, finding, note, warning
from capture_cli.log.measured_log import SETTINGS as MEASURED_LOG
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.contacts import can_touch
from capture_cli.model.tasks.base import Channel, Task
from capture_cli.store.inspection import Inspection


@frozen
class SETTINGS:
    uneven: float = 0.1  # sd of the interval, over its median
    saturated: float = 0.05  # share of the samples at exactly one extreme
    several_visits: int = 3  # a channel that returns to exactly the same extreme is held there by something
    piled_up: float = 5.0  # times the share at the values next to an extreme: a quantised sine has 3
    many_levels: int = 10  # fewer are a switched signal, which is at its extremes by design
    mostly_at_rest: float = 0.5
    examples: int = 3


def log_findings(seen: Inspection, task: Task | None) -> list[Finding]:
    """Findings on the `episodes` and `channels` of an inspection. task: theirs, where it is known."""
    episodes = seen.episodes
    return [
        *_timing(episodes, seen.time_scatter),
        *_jitter(seen.time_scatter, seen.channels),
        *(f for c in seen.channels for f in _values(c, len(episodes))),
        *(f for c in seen.channels if c["kind"] == "input" for f in _input(c)),
        *(f for c in seen.channels if c["kind"] == "output" for f in _output(c, task)),
        *_held([c for c in seen.channels if c.get("held")], task),
    ]


def task_findings(log: MeasuredLog, seen: Inspection, task: Task) -> list[Finding]:
    """Findings on whether `log`, with its inspection, fits `task`."""
    found = list(_names(log, task))
    if any(f["severity"] == "error" for f in found):
        return found
    given = Inspected(log, task, seen.episodes)
    return [*found, *(f for check in in_order() for f in check().findings(given))]


# --- timing ---


def _timing(episodes: Sequence[Mapping[str, Any]], jitter: Mapping[str, Any] | None) -> Iterator[Finding]:
    for key, what in (("backward_times", "goes back"), ("repeated_times", "stands still")):
        count, where, examples = _gather(
            episodes, key, lambda p: f"after {p['time']:.6g} s (step {p['step']})"
        )
        if count:
            yield error(
                where,
                f"time {what} in {count} place{'s' * (count > 1)}: {examples}",
                "sort the rows by time, remove repeated ones, and import the files again; where an episode "
                "begins, name the column that tells episodes apart in [log] episode",
            )
    count, where, examples = _gather(
        episodes, "gaps", lambda p: f"{p['interval']:.3g} s after {p['time']:.6g} s"
    )
    if count:
        yield warning(
            where,
            f"{count} gap{'s' * (count > 1)} in the sampling: {examples}",
            "windows end at a gap, so nothing needs doing; look for lost messages if there are many",
        )
    uneven = [e for e in episodes if e["jitter_sd"] is not None and e["jitter_sd"] > SETTINGS.uneven]
    if uneven and jitter is None:
        worst = max(uneven, key=lambda e: e["jitter_sd"])
        yield note(
            _episode(worst) if len(uneven) == 1 else f"{len(uneven)} episodes",
            f"sampling is uneven: the interval's sd is {percent(worst['jitter_sd'])} of its median, "
            f"the longest is {worst['jitter_max']:.3g} times the median",
            "nothing to do: every sample is compared at its own time, and a model's step takes the mean of its inputs",
        )


def _jitter(jitter: Mapping[str, Any] | None, channels: Sequence[Mapping[str, Any]]) -> Iterator[Finding]:
    """Time stamps that jitter about even times at which outputs are smoother."""
    if jitter is None:
        return
    own = {c["name"]: c for c in channels if c["kind"] == "output"}
    smoother = [
        f"{name} has a noise of {_in_unit(there, own[name])} there, and {_in_unit(here, own[name])} at its stamps"
        for name, (here, there) in jitter["smoother"].items()
    ]
    yield warning(
        "time",
        f"time stamps jitter by {1e3 * jitter['sd']:.3g} ms (sd) about even times: "
        f"{first_of(smoother, SETTINGS.examples)}",
        "import the files again with --even-times, or stamp samples where they are measured and not where they arrive",
    )


def _gather(episodes, key: str, describe) -> tuple[int, str, str]:
    """How many over all episodes, where, and the first few described."""
    having = [e for e in episodes if e[key]["count"]]
    count = sum(e[key]["count"] for e in having)
    places = [describe(p) for e in having for p in e[key]["first"]]
    where = _episode(having[0]) if len(having) == 1 else f"{len(having)} episodes"
    return count, where, first_of(places, SETTINGS.examples, count)


def _episode(episode: Mapping[str, Any]) -> str:
    return f"{episode['recording']}, episode {episode['episode']}"


# --- values ---


def _in_unit(value: float, channel: Mapping[str, Any], digits: int = 3) -> str:
    """A value of the channel, before its unit if it has one."""
    return with_unit(f"{value:.{digits}g}", channel["unit"])


def _values(channel: Mapping[str, Any], episodes: int) -> Iterator[Finding]:
    where, is_input = f"{channel['kind']} {channel['name']}", channel["kind"] == "input"
    bad = channel["nan"] + channel["infinite"]
    if bad:
        steps = first_of((f"step {i}" for i in channel["bad_steps"]), SETTINGS.examples, bad)
        yield error(
            where,
            f"{bad} values are NaN, infinite or beyond {DOCUMENTS.largest:g}: {steps}",
            "import the files again with --drop-nan, or correct them in the source",
        )
    sampling = channel.get("sampling")
    if sampling is not None and sampling["fewest"] < MEASURED_LOG.fewest_of_a_sparse:
        yield error(
            where,
            f"is sparse, and an episode has {sampling['fewest']} samples of it; "
            f"{MEASURED_LOG.fewest_of_a_sparse} are needed",
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
            f"never changes in {len(still)} of {episodes} episodes: {first_of(still, SETTINGS.examples)}",
            "nothing to do, if the machine stood still there; otherwise leave those episodes out",
        )


def _input(channel: Mapping[str, Any]) -> Iterator[Finding]:
    where, moves = f"input {channel['name']}", channel["excitation"]
    for extreme in _extremes(channel):
        if extreme["value"] != 0:
            yield finding(
                "warning" if extreme["visits"] >= SETTINGS.several_visits else "note",
                where,
                f"is at exactly {_in_unit(extreme['value'], channel, 6)} for {percent(extreme['share'])} "
                f"of the samples, in {extreme['visits']} stays: saturated, or held?",
                "nothing to do if this is what reached the actuator; if it is what was asked of it, log the former",
            )
    if (
        moves["at_rest"] is not None
        and moves["at_rest"] > SETTINGS.mostly_at_rest
        and not channel["constant"]
    ):
        yield note(
            where,
            f"is at rest (near 0) for {percent(moves['at_rest'])} of the samples",
            "excite it for longer if intervals come out wide",
        )
    if moves["single_frequency"] is not None:
        yield warning(
            where,
            f"changes at a single frequency, {moves['single_frequency']:.3g} Hz",
            "one frequency cannot tell inertia from stiffness: use several, steps, or a sweep",
        )


def _extremes(channel: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The ends of a channel's range at which it is suspiciously often."""
    if channel["levels"] <= SETTINGS.many_levels:
        return []
    ends = [channel["low"], channel["high"]]
    return [
        e
        for e in ends
        if e["share"] > SETTINGS.saturated and e["share"] > SETTINGS.piled_up * e["neighbours"]
    ]


def _output(channel: Mapping[str, Any], task: Task | None) -> Iterator[Finding]:
    where, grid = f"output {channel['name']}", channel["quantisation"]
    for extreme in _extremes(channel):
        if extreme["visits"] >= SETTINGS.several_visits:
            yield warning(
                where,
                f"is at exactly {_in_unit(extreme['value'], channel, 6)} for {percent(extreme['share'])} "
                f"of the samples, in {extreme['visits']} stays: the sensor's range, or an end stop?",
                "leave those episodes out if the sensor clips; put a stop into the model",
            )
    moves_less = grid["step"] is not None and grid["change"] is not None and grid["change"] <= grid["step"]
    if moves_less and channel["held"] is None:  # of one that repeats its samples most changes are 0
        yield note(
            where,
            f"is quantised in steps of {_in_unit(grid['step'], channel)} "
            f"(sd {grid['step'] / np.sqrt(12):.2g}), and moves less than that from sample to sample",
            "nothing to do: the noise floor will show it",
        )
    out = channel["spikes"]
    if out["count"]:
        count = out["count"]
        steps = first_of((f"step {i}" for i in out["first"]), SETTINGS.examples, count)
        ends = f" ({out['ends']} of them at an end of an episode)" if out["ends"] else ""
        yield warning(
            where,
            f"{count} single sample{'s stand' if count > 1 else ' stands'} out, by up to "
            f"{_in_unit(out['largest'], channel)}: {steps}{ends}",
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
        yield warning(
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
        yield warning(
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
        yield error(
            f"output {sensor}",
            f"the log has it as sparse, and task {task.name!r} does not",
            f"write sparse = true under [outputs.{sensor}]",
        )


def _channel_names(kind: str, names, units, channels: Sequence[Channel], task: str) -> Iterator[Finding]:
    expected = tuple(c.name for c in channels)
    again = "import the files again with this task"
    if tuple(names) != expected:
        message = f"the log has ({', '.join(names)}); task {task!r} has ({', '.join(expected)})"
        yield error(kind, message, again)
        return
    for c, unit in zip(channels, units, strict=True):
        if unit != c.unit:
            message = f"the log has it in {unit!r}, task {task!r} in {c.unit!r}"
            yield error(f"{kind[:-1]} {c.name}", message, again)
