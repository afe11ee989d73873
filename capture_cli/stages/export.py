"""`capture export`: an estimate or a diagnosis in, an MJCF out; beside it what MuJoCo has no feature for."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.diagnosis.expression import expression_terms
from capture_cli.effects.companion import MADE_BY_EXPORT, companion_module
from capture_cli.effects.placed import placed_name
from capture_cli.errors import OptionError, OutputError, StoreError
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.model.tasks.base import Task
from capture_cli.sim.engine import ModelFields
from capture_cli.sim.mjcf import to_mjcf
from capture_cli.stages.recorded.recorded_effects import WithValues, declared_values, recorded_effects
from capture_cli.stages.recorded.recorded_task import load_recorded, task_inputs
from capture_cli.store.diagnosis import Diagnosis
from capture_cli.store.estimate import Estimate
from capture_cli.store.output import New, new_outputs, refuse_existing, refuse_inputs, refuse_misnamed
from capture_cli.store.result import check_bounds, is_within, read_provenance

MADE_BY = {"capture/estimate": "identify", "capture/diagnosis": "diagnose"}


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
    found = _read(result)
    command = MADE_BY[found["format"]]
    provenance = read_provenance(result, f"make it again with `capture {command}`")
    machine = load_recorded(result, provenance, task, found["log"]["path"])
    refuse_inputs(out, [result, *task_inputs(machine).values()])
    refuse_misnamed(out, ".xml")
    if machine.name != found["task"]:
        raise OptionError(
            f"{result} belongs to the task {found['task']!r}, and --task is {machine.name!r}",
            cure=f"give the task that {result} was made with",
        )
    expression = found.get("expression") or {}
    if expression.get("terms"):
        found = _with_expression(found, expression, str(result))
    values = declared_values(found["parameters"], machine.space, str(result), command)
    effects = recorded_effects(found.get("effects", []), machine.model, command)
    effects |= _terms(expression.get("terms", []), machine, command)
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
    header = _header(found, command, machine.space, values, effects, companion)
    texts = {out: to_mjcf(machine.model_path, fields, out, header)}
    if companion:
        texts[companion] = companion_module(out.name, machine.name, beside, _substeps(effects))
    outdated = [module_path] if stale else []
    with new_outputs(*map(New, texts), force=force, outdated=outdated) as files:
        for file, text in zip(files, texts.values(), strict=True):
            file.write_text(text, encoding="utf-8")
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


def _read(result: Path) -> Mapping[str, Any]:
    """The document of an estimate or diagnosis directory."""
    if (result / "diagnosis.json").is_file():
        return Diagnosis.read(result).document
    if (result / "estimate.json").is_file():
        return Estimate.read(result).document
    raise StoreError(
        f"{result} holds neither estimate.json nor diagnosis.json",
        cure="give a directory that `capture identify` or `capture diagnose` made",
    )


def _substeps(effects: WithValues) -> int:
    """Steps of the exported model in one of the task's own."""
    return math.prod(effect.substeps for effect, _ in effects.values())


def _with_expression(
    found: Mapping[str, Any], expression: Mapping[str, Any], whose: str
) -> Mapping[str, Any]:
    """The diagnosis with the values that parameters and effects have beside its formula."""
    if "values" not in expression:
        raise StoreError(
            f"{whose} has a formula without the values that go with it", cure="run `capture diagnose` again"
        )

    def there(parameters: Mapping[str, Any], owner: str = "") -> dict[str, Any]:
        missing = [owner + n for n in parameters if owner + n not in expression["values"]]
        if missing:
            raise StoreError(
                f"{whose} has a formula, and among the values that go with it none of {', '.join(missing)}",
                cure="run `capture diagnose` again",
            )
        return {n: {**p, "value": expression["values"][owner + n]} for n, p in parameters.items()}

    effects = [
        {**row, "parameters": there(row["parameters"], f"{placed_name(row['name'], row['site'])}.")}
        for row in found["effects"]
    ]
    beside = {**found, "parameters": there(found["parameters"]), "effects": effects}
    check_bounds(beside, f"{whose}: the values that go with its formula", "run `capture diagnose` again")
    return beside


def _terms(rows: Sequence[Mapping[str, Any]], machine: Task, command: str) -> WithValues:
    """The terms of a formula. Raises StoreError where the model has no place for one any more."""
    if not rows:
        return {}
    terms = expression_terms(machine.model, [c.index for c in machine.inputs])
    there = {placed.effect.site: placed for placed in terms}
    for row in rows:
        if row["site"] not in there:
            raise StoreError(
                f"the formula has the term {row['site']!r}, which the model has not",
                cure=f"run `capture {command}` again with the task as it is now",
            )
        (coefficient,) = there[row["site"]].effect.parameters
        if not is_within(row["coefficient"], coefficient.low, coefficient.high):
            raise StoreError(
                f"the formula has {row['coefficient']:g} times {row['site']!r}, outside of its bounds, "
                f"{coefficient.low:g} to {coefficient.high:g}",
                cure=f"run `capture {command}` again with the task as it is now",
            )
    chosen = [(there[row["site"]], np.array([row["coefficient"]])) for row in rows]
    return {placed.name: (placed.effect, value) for placed, value in chosen}


def _header(
    found, command: str, space: ParameterSpace, values, effects: WithValues, companion: Path | None
) -> str:
    """An XML comment that says what the file holds, and what it does not."""
    lines = [f"made by `capture {command}` and `capture export`; verdict: {found['verdict']}"]
    lines += [f"  {_size(p, v)}" for p, v in zip(space, values, strict=True)]
    if effects and "first_time" in found["log"]:
        lines.append(f"  time 0 was {_first_time(found):.6f} s in the log")
    for name, (effect, own) in effects.items():
        where = "" if effect.place == "model" else f" (in {companion.name})"
        lines.append(f"  {name}{where}")
        lines += [f"    {_size(p, v)}" for p, v in zip(effect.parameters, own, strict=True)]
    if _substeps(effects) > 1:
        lines.append(
            f"  the model steps {_substeps(effects)} times in each step of the grid on which controls come and"
        )
        lines.append(
            "  sensors are read: hold each control over as many, and take the sensors of the first of them"
        )
    text = re.sub("-(?=-)", "- ", "\n".join(lines))  # two in a row would end the comment
    return f"<!-- {text}\n-->\n"


def _first_time(found: Mapping[str, Any]) -> float:
    """s, by the log's clock: since when time counts, of the effect that counts it from elsewhere than the others."""
    usual = found["log"]["first_time"]
    own = (row.get("first_time", usual) for row in found.get("effects", []))
    return next((time for time in own if time != usual), usual)


def _size(parameter: Parameter, value: float) -> str:
    return f"{parameter.name} = {value:.9g} {parameter.unit}".removesuffix(" 1")
