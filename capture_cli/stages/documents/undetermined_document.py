"""What the log leaves open of the parameters, as result files have it, in numbers and in a sentence."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from capture_cli.common.quantities import significant, told, with_unit
from capture_cli.estimate.solve.intervals import Intervals
from capture_cli.estimate.solve.undetermined import NOTHING, PRODUCT, Undetermined, undetermined
from capture_cli.model.parameters import ParameterSpace

Rows = Mapping[str, Mapping[str, Any]]  # of parameters by name, as result files have them


def undetermined_of(space: ParameterSpace, point: np.ndarray, sure: Intervals) -> list[dict[str, Any]]:
    """What is open of the parameters at `point` (parameter,), each alone or several together, most open first."""
    rows = dict(zip(space.names, sure.rows(space, point, range(len(space))), strict=True))
    return [_document(found, rows) for found in undetermined(sure, space, point)]


def with_limits(name: str, row: Mapping[str, Any]) -> str:
    """ "grip (at least 0.62)", or the name alone of a parameter of which the log says nothing."""
    return f"{name} ({told(row)})" if row["limits"] else name


def _document(found: Undetermined, rows: Rows) -> dict[str, Any]:
    every = list(rows)
    names = [every[i] for i in found.which]
    order = np.argsort(-np.abs(found.change), kind="stable")
    first = found.change[order[0]]
    return {
        "combination": {names[k]: round(float(found.change[k] / first), 4) for k in order},
        "sd_over_range": found.sd_over_range,
        "known": found.known,
        "scaled": [names[k] for k in found.scaled],
        "factor": None if found.factor is None else list(found.factor),
        "ends": None if found.ends is None else dict(zip(names, found.ends.T.tolist(), strict=True)),
        "text": _sentence(found, names, rows),
    }


def _sentence(found: Undetermined, names: Sequence[str], rows: Rows) -> str:
    """What is known of the parameters called `names`."""
    if found.known == NOTHING:
        return f"This log does not determine {with_limits(names[0], rows[names[0]])}."
    if found.factor is None:
        return _combination(found, names, rows)
    by = " to ".join(significant(factor, 2) for factor in found.factor)
    if found.known == PRODUCT:
        return f"{_only('the product', names)}: one can be scaled by {by}, the other by the inverse."
    scaled = [names[k] for k in found.scaled]
    text = f"{_only('the ratio' + 's' * (len(scaled) > 2), scaled)}: together they can be scaled by {by}"
    others = [k for k, name in enumerate(names) if name not in scaled]
    return ", with ".join([text, *(_between(names[k], found.ends[:, k], rows) for k in others)]) + "."


def _combination(found: Undetermined, names: Sequence[str], rows: Rows) -> str:
    left = len(names) - found.open
    text = _only("a combination" if left == 1 else f"{left} combinations", names)
    if found.ends is None:
        return f"{text}."
    one, other = (
        " with ".join(f"{n} {_value(v, n, rows)}" for n, v in zip(names, ends, strict=True))
        for ends in found.ends
    )
    return f"{text}: {one} is as good as {other}."


def _only(what: str, names: Sequence[str]) -> str:
    are = "are" if what.endswith("s") else "is"
    return f"Only {what} of {', '.join(names[:-1])} and {names[-1]} {are} known"


def _between(name: str, ends: np.ndarray, rows: Rows) -> str:
    return f"{name} from {significant(ends[0])} to {_value(ends[1], name, rows)}"


def _value(value: float, name: str, rows: Rows) -> str:
    return with_unit(significant(value), rows[name]["unit"])
