"""Values and effects of an estimate or a diagnosis, made of its document again."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from capture_cli.errors import StoreError
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.base import Effect
from capture_cli.model.effects.placed import Placed
from capture_cli.model.effects.ranges import WithValues
from capture_cli.model.parameters import ParameterSpace
from capture_cli.model.tasks.base import Task
from capture_cli.select.expression import NAME as FORMULA
from capture_cli.select.expression import expression_terms


def recorded_values(
    parameters: Mapping[str, Any], space: ParameterSpace, whose: str, command: str
) -> np.ndarray:
    """Values (parameter,) of a document's parameters. Raises StoreError where `space` has others."""
    if set(parameters) != set(space.names):
        raise StoreError(
            f"{whose} has the parameters ({', '.join(sorted(parameters))}); "
            f"now there are ({', '.join(sorted(space.names))})",
            cure=f"run `capture {command}` again with the task as it is now",
        )
    return space.to_vector({name: p["value"] for name, p in parameters.items()})


def recorded_effects(rows: Iterable[Mapping[str, Any]], task: Task, command: str) -> WithValues:
    """The effects that a document has in `rows`, which `command` wrote. Raises CaptureError where the task's model has
    no place for one any more.
    """
    effects = {}
    for row in rows:
        if row["name"] == FORMULA:
            effect = formula_term(row["site"], task, command)
        else:
            effect = REGISTRY.get(row["name"])(task.model, row["site"])
        name = Placed(row["name"], effect).name
        known = {n: p for n, p in row["parameters"].items() if not effect.of_one_recording(n)}
        known = _of_what_was_not_logged(effect) | known
        values = recorded_values(known, effect.space, name, command)
        effects[name] = (effect, _null_of_here(effect.space, values, known))
    return effects


def placed_effects(effects: WithValues) -> list[tuple[Placed, np.ndarray]]:
    """The effects where they sit, with their values (parameter,)."""
    return [(Placed(name.partition("@")[0], effect), own) for name, (effect, own) in effects.items()]


def formula_term(site: str, task: Task, command: str) -> Effect:
    """The term of a formula, "JOINT: TERM". Raises StoreError where the task's model has no such joint or input."""
    there = {p.effect.site: p.effect for p in expression_terms(task.model, [c.index for c in task.inputs])}
    if site not in there:
        raise StoreError(
            f"the formula has the term {site!r}, which the model has not",
            cure=f"run `capture {command}` again with the task as it is now",
        )
    return there[site]


def _of_what_was_not_logged(effect: Effect) -> dict[str, dict[str, float]]:
    """Null for each of a sensor's several numbers, which a diagnosis leaves out where its log lacked them."""
    if not effect.number_by_number or len(effect.parameters) == 1:
        return {}
    return {p.name: {"value": p.nominal, "high": p.high} for p in effect.parameters}


def _null_of_here(space: ParameterSpace, values: np.ndarray, recorded: Mapping[str, Any]) -> np.ndarray:
    """`values` (parameter,), and where one is null in the diagnosis, as which it is `recorded`, the null of `space`.

    A limit's null is the end of its range, and `diagnose` has that from how far the log drove the actuators.
    """
    ends = np.array([recorded[name]["high"] for name in space.names])
    return np.where((space.nominal == space.high) & (values == ends), space.nominal, values)
