"""`capture export`: an estimate or a diagnosis in, an MJCF out; beside it what MuJoCo has no feature for."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from capture_cli.errors import OutputError
from capture_cli.model.effects.companion import MADE_BY_EXPORT, companion_module
from capture_cli.model.effects.ranges import WithValues
from capture_cli.model.fields import ModelFields
from capture_cli.model.mjcf.mjcf_writer import to_mjcf
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.stages.recorded.found_model import FoundModel
from capture_cli.stages.recorded.recorded_task import task_inputs
from capture_cli.store.output import refuse_existing, refuse_inputs, refuse_misnamed, write_texts


@dataclass(frozen=True)
class Exported:
    """model: the MJCF. companion: the Python module beside it, None where nothing needs one; effects: those in it.

    verdict, summary: those of what was exported.
    """

    model: Path
    companion: Path | None
    effects: tuple[str, ...]
    verdict: str
    summary: str


def export(*, result: Path, out: Path, task: str | None = None, force: bool = False) -> Exported:
    """Write the task's model with the values of `result`, an estimate or diagnosis directory, to the file `out`.

    Effects that MuJoCo has a feature for are in it; the others, and terms of a formula, go to STEM_effects.py, beside
    `out`. With a formula all values are those of the model with it. task: where the task is now, if it was moved
    since. A STEM_effects.py of an earlier export is in the way like an `out` that exists; with `force` it is replaced,
    or removed if it is not needed any more. Raises CaptureError for whatever the user can mend; then nothing is
    written.
    """
    model = FoundModel.read(result, task)
    machine, values, effects, found = model.task, model.values, model.effects, model.document
    refuse_inputs(out, [result, *task_inputs(machine).values()])
    refuse_misnamed(out, ".xml")
    fields = ModelFields(machine.model, 1)
    machine.write(fields, values[None])
    for effect, own in effects.values():
        effect.write(fields, own[None])
    beside = {name: pair for name, pair in effects.items() if pair[0].place != "model"}
    module_path = out.with_name(f"{out.stem}_effects.py")
    companion = module_path if beside else None
    if companion:
        _refuse_foreign(companion)
    stale = not beside and _is_exported(module_path)
    if stale:
        refuse_existing(module_path, force=force)
    header = _header(found, model.command, machine.space, values, effects, companion)
    texts = [(out, to_mjcf(machine.model_path, fields, out, header))]
    if companion:
        texts.append((companion, companion_module(out.name, machine.name, beside, _substeps(effects))))
    write_texts(texts, force=force, outdated=[module_path] if stale else [])
    return Exported(out, companion, tuple(beside), found["verdict"], found.get("summary", ""))


def _is_exported(path: Path) -> bool:
    """Whether there is a module that `capture export` made: one that it did not is no business of ours."""
    return path.is_file() and MADE_BY_EXPORT in path.read_text(encoding="utf-8", errors="replace")[:1000]


def _refuse_foreign(companion: Path) -> None:
    """Raise OutputError where something else than an export lies in the place of the module: --force is for --out."""
    if companion.exists() and not _is_exported(companion):
        raise OutputError(
            f"{companion} exists already and `capture export` did not write it, so --force does not replace it",
            cure="choose another --out (the module is named after it), or move that file away",
        )


def _substeps(effects: WithValues) -> int:
    """Steps of the exported model in one of the task's own."""
    return math.prod(effect.substeps for effect, _ in effects.values())


def _header(
    found, command: str, space: ParameterSpace, values, effects: WithValues, companion: Path | None
) -> str:
    """An XML comment on what is in the file, and what is beside it."""
    lines = [f"made by `capture {command}` and `capture export`; verdict: {found['verdict']}"]
    lines += [f"  {_size(p, v)}" for p, v in zip(space, values, strict=True)]
    if effects and "first_time" in found["log"]:
        lines.append(f"  time 0 was {_first_time(found):.6f} s in the log")
    for name, (effect, own) in effects.items():
        where = "" if effect.place == "model" else f" (in {companion.name})"
        lines.append(f"  {name}{where}")
        lines += [f"    {_size(p, v)}" for p, v in zip(effect.parameters, own, strict=True)]
    if _substeps(effects) > 1:
        lines += [
            f"  the model steps {_substeps(effects)} times in each step of the grid on which controls come and",
            "  sensors are read: hold each control over as many, and take the sensors of the first of them",
        ]
    text = re.sub("-(?=-)", "- ", "\n".join(lines))  # two in a row would end the comment
    return f"<!-- {text}\n-->\n"


def _first_time(found: Mapping[str, Any]) -> float:
    """s, by the log's clock: since when time counts, of the effect that counts it from elsewhere than the others."""
    usual = found["log"]["first_time"]
    own = (row.get("first_time", usual) for row in found.get("effects", []))
    return next((time for time in own if time != usual), usual)


def _size(parameter: Parameter, value: float) -> str:
    return f"{parameter.name} = {value:.9g} {parameter.unit}".removesuffix(" 1")
