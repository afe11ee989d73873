"""`capture draft-task`: an MJCF and the columns of a log in, a task.toml out, to go through by hand."""

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr

from capture_cli.errors import LogError, ModelError
from capture_cli.log.readers import open_source
from capture_cli.model.mjcf.model_file import compile_file
from capture_cli.model.sensor_units import unit_in_name
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.mjcf_file import FORMAT
from capture_cli.stages.drafting.channels import Channel, Opened, inputs_of, outputs_of, parameters_of
from capture_cli.stages.drafting.column_names import POSITION, VELOCITY, matched, time_column
from capture_cli.store.output import refuse_existing, refuse_inputs, refuse_misnamed, write_texts

SENSORS = {POSITION: "jointpos", VELOCITY: "jointvel"}
_BARE = re.compile(r"[A-Za-z0-9_-]+")  # a key of TOML without quotes


@dataclass(frozen=True)
class Draft:
    """task: the file written. model: the one given, or another with the sensors that it lacks. columns: of each
    channel. unused: of the log, in no channel.
    """

    task: Path
    model: Path
    columns: dict[str, list[str]]
    parameters: tuple[str, ...]
    unused: tuple[str, ...]


def draft_task(*, model: Path, out: Path, log: Path | None = None, force: bool = False) -> Draft:
    """Write a first task file for the MJCF at `model` to `out`: columns by their names in `log`, or called like the
    channels where None; damping, dry friction and armature of every joint, and gains of servos, as parameters.

    Where joints have no sensors, these go to STEM_sensors.xml beside the model, which includes it. Raises CaptureError
    where nothing can be measured, or no column of the log looks like anything measured; then nothing is written.
    """
    refuse_misnamed(out, ".toml")
    refuse_inputs(out, [model, *([log] if log else [])])
    refuse_existing(out, force=force)
    compiled = compile_file(model)
    inputs, outputs = list(inputs_of(compiled)), list(outputs_of(compiled))
    columns = open_source(log).columns if log else ()
    time = time_column(columns)
    others = [c for c in columns if c != time]
    found = _found([*inputs, *outputs], others) if log else _named_alike(inputs, outputs)
    measured = [o for o in outputs if o.name in found]
    if not measured:
        raise _nothing_measured(model, log, columns, outputs)
    lacking = [o for o in measured if o.joint]
    beside = model.with_name(f"{model.stem}_sensors.xml") if lacking else model
    opened = list(parameters_of(compiled))
    driven = [i for i in inputs if i.name in found]
    lines = [
        *_head(model.stem, os.path.relpath(beside, out.parent), time, log),
        *_parameters(opened),
        *_channels("inputs", driven, found),
    ]
    lines += [*_channels("outputs", measured, found), *_without_column(inputs, outputs, found, log)]
    texts = [(out, "\n".join(lines) + "\n")]
    if lacking:
        texts.append((beside, _with_sensors(model, lacking)))
    write_texts(texts, force=force)
    load_task(str(out))
    names = {n: [c for c in own if c] for n, own in found.items()}
    used = {column for own in names.values() for column in own}
    return Draft(out, beside, names, tuple(p.name for p in opened), tuple(c for c in others if c not in used))


def _found(channels: Sequence[Channel], columns: Sequence[str]) -> dict[str, list[str]]:
    """The columns of each channel that has some, "" of a value that has none."""
    each = iter(matched([w for c in channels for w in c.wanted], columns))
    own = {c.name: [next(each) or "" for _ in c.wanted] for c in channels}
    return {c.name: own[c.name] for c in channels if (all if c.whole else any)(own[c.name])}


def _named_alike(inputs: Sequence[Channel], outputs: Sequence[Channel]) -> dict[str, list[str]]:
    """Columns that are called like the channels: of the outputs those that have a sensor, and positions of joints."""
    asked = [*inputs, *(o for o in outputs if o.role in (None, POSITION))]
    return {c.name: [c.name + w.axis for w in c.wanted] for c in asked}


def _nothing_measured(
    model: Path, log: Path | None, columns: Sequence[str], outputs: Sequence[Channel]
) -> LogError | ModelError:
    if log is None or not outputs:
        return ModelError(
            f"{model} has no sensor with a name, and no hinge or slide joint with one",
            cure="name its joints, or add what was measured under <sensor>",
        )
    return LogError(
        f"{log}: no column looks like what {model} could measure; there are {', '.join(columns):.200}",
        cure="name columns after joints or sensors, as in "
        f"{outputs[0].wanted[0].names[0].strip()}_pos; or leave out --log, and write the columns by hand",
    )


def _head(name: str, model: str, time: str | None, log: Path | None) -> Iterator[str]:
    yield f"# A draft of `capture draft-task`{f', by the columns of {log.name}' if log else ''}. Go through it: are the"
    yield "# columns the right ones, and may the machine be outside of the bounds? Docs: task-file.md"
    yield f"format = {FORMAT}"
    yield f"name = {json.dumps(name)}"
    yield f"model = {json.dumps(model)}"
    yield "\n[log]"
    unknown = "" if time or not log else "  # no column is called so"
    yield f"time = {json.dumps(time or 'time')}{unknown}"
    if written := unit_in_name(time or "", "s"):
        yield f"time_scale = {written[1]:g}"


def _parameters(opened: Sequence[Opened]) -> Iterator[str]:
    for p in opened:
        yield f"\n[parameters.{_key(p.name)}]\nset = {json.dumps(p.target)}"
        yield f"low = {p.low:.3g}\nhigh = {p.high:.3g}\nunit = {json.dumps(p.unit)}"


def _channels(kind: str, channels: Sequence[Channel], found: Mapping[str, list[str]]) -> Iterator[str]:
    for channel in channels:
        columns = found[channel.name]
        yield f"\n[{kind}.{_key(channel.name)}]"
        yield f"column = {json.dumps(columns if len(channel.wanted) > 1 else columns[0])}"
        yield f"unit = {json.dumps(channel.unit)}"
        written = {unit_in_name(c, channel.unit) for c in columns if c} - {None}
        if len(written) == 1:
            yield f"column_unit = {json.dumps(written.pop()[0])}"


def _without_column(
    inputs: Sequence[Channel], outputs: Sequence[Channel], found: Mapping[str, list[str]], log: Path | None
) -> Iterator[str]:
    left = [c.name for c in (*inputs, *outputs) if c.name not in found and not c.joint]
    if left and log:
        yield f"\n# No column of {log.name} looks like: {', '.join(left)}"


def _with_sensors(model: Path, lacking: Sequence[Channel]) -> str:
    """An MJCF that is the model, and sensors of joints."""
    lines = ["<mujoco>", f"  <include file={quoteattr(model.name)}/>", "  <sensor>"]
    for o in lacking:
        lines.append(f"    <{SENSORS[o.role]} name={quoteattr(o.name)} joint={quoteattr(o.joint)}/>")
    return "\n".join([*lines, "  </sensor>", "</mujoco>", ""])


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else json.dumps(name)
