"""The model that `identify` or `diagnose` found: the task, values of its parameters, effects and terms of a formula."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from capture_cli.errors import OptionError, StoreError
from capture_cli.model.effects.placed import Placed, placed_name
from capture_cli.model.effects.ranges import WithValues
from capture_cli.model.parameters import ParameterSpace
from capture_cli.model.tasks.base import Task
from capture_cli.select.expression import NAME as FORMULA
from capture_cli.select.recorded_effects import (
    formula_term,
    placed_effects,
    recorded_effects,
    recorded_values,
)
from capture_cli.stages.recorded.recorded_task import load_recorded
from capture_cli.store.diagnosis import Diagnosis
from capture_cli.store.estimate import Estimate
from capture_cli.store.result import Result, check_bounds, is_within, read_provenance

MADE_BY = {Estimate: "identify", Diagnosis: "diagnose"}


@dataclass(frozen=True)
class FoundModel:
    """values (parameter,): of the task's parameters. effects: those of a diagnosis, and the terms of its formula. Where
    there is a formula, all values are those that were fitted with it. document: of the estimate or the diagnosis, which
    `command` made.
    """

    task: Task
    values: np.ndarray
    effects: WithValues
    document: Mapping[str, Any]
    command: str

    @classmethod
    def read(cls, result: Path, task: str | None = None) -> Self:
        """Of the estimate or diagnosis directory `result`; task: where its task is now, if it was moved since. Raises
        CaptureError.
        """
        kind = kind_of(result)
        found, command = kind.read(result).document, MADE_BY[kind]
        machine = _machine(result, kind, found, task)
        if machine.name != found["task"]:
            raise OptionError(
                f"{result} belongs to the task {found['task']!r}, and --task is {machine.name!r}",
                cure=f"give the task that {result} was made with",
            )
        expression = found.get("expression") or {}
        if expression.get("terms"):
            found = _with_expression(found, expression, str(result))
        values = declared_values(found["parameters"], machine.space, str(result), command)
        effects = recorded_effects(found["effects"], machine, command)
        effects |= _terms(expression.get("terms", []), machine, command)
        return cls(machine, values, effects, found, command)


def kind_of(result: Path) -> type[Estimate] | type[Diagnosis]:
    """Of the result in that directory. Raises StoreError where there is none."""
    for kind in (Diagnosis, Estimate):
        if (result / f"{kind.NAME}.json").is_file():
            return kind
    what = "holds neither estimate.json nor diagnosis.json" if result.exists() else "does not exist"
    raise StoreError(
        f"{result} {what}",
        cure="give a directory that `capture identify` or `capture diagnose` made",
    )


def proposed_machine(result: Path, task: str | None) -> tuple[Task, str]:
    """The machine that a proposal by `result` is for, and the path of its log; task: as of `FoundModel.read`.

    It has the effects of an estimate; of a diagnosis it is the declared one, beside which effects are judged. Raises
    CaptureError.
    """
    kind = kind_of(result)
    found = kind.read_document(result)
    machine = _machine(result, kind, found, task)
    if kind is Estimate:
        machine = machine.with_effects(
            placed_effects(recorded_effects(found["effects"], machine, "identify"))
        )
    return machine, found["log"]["path"]


def _machine(result: Path, kind: type[Result], found: Mapping[str, Any], task: str | None) -> Task:
    """The task of the document `found` in the directory `result`, as it was then."""
    return load_recorded(result, read_provenance(result, kind.KIND.cure), task, found["log"]["path"])


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
    terms = {}
    for row in rows:
        effect = formula_term(row["site"], machine, command)
        (coefficient,) = effect.parameters
        if not is_within(row["coefficient"], coefficient.low, coefficient.high):
            raise StoreError(
                f"the formula has {row['coefficient']:g} times {row['site']!r}, outside of its bounds, "
                f"{coefficient.low:g} to {coefficient.high:g}",
                cure=f"run `capture {command}` again with the task as it is now",
            )
        terms[Placed(FORMULA, effect).name] = (effect, np.array([row["coefficient"]]))
    return terms


def declared_values(
    parameters: Mapping[str, Any], space: ParameterSpace, whose: str, command: str
) -> np.ndarray:
    """As `recorded_values`, for the parameters of a task. Raises StoreError also for one outside of its bounds."""
    values = recorded_values(parameters, space, whose, command)
    for parameter, value in zip(space, values, strict=True):
        if not is_within(value, parameter.low, parameter.high):
            raise StoreError(
                f"{whose} has {parameter.name} = {value:g}, and the task lets it be {parameter.low:g} to "
                f"{parameter.high:g}",
                cure=f"run `capture {command}` again with the task as it is now",
            )
    return values
