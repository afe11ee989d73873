"""Errors in open loop, in words and rows: one source for the page and the terminal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capture_cli.common.quantities import MISSING, scaled_unit, significant, with_unit
from capture_cli.store.result import Record

PARTS = {"test": "held out", "fit": "fitted"}
DIVERGED = "diverged"
WHOLE = "whole"


@dataclass(frozen=True)
class Cell:
    """The errors of one output over some runs, of each model in order: in the unit that it is shown in, in degrees
    (empty of what is no angle), and over the noise floor.
    """

    values: tuple[str, ...]
    degrees: tuple[str, ...]
    over: tuple[str, ...]


@dataclass(frozen=True)
class Row:
    """Errors in `unit` of what is called `name`."""

    name: str
    unit: str
    cells: list[Cell]


@dataclass(frozen=True)
class Predictions:
    """Of one part of the log, by its words. models: their names, the last of which the record is about. rows: of each
    output, with a cell for each of the `horizons`. together: over the noise floor, of all outputs, likewise.
    recordings: of each, its name, how long it is, and a cell for each output; none where there is a single one.
    """

    part: str
    models: list[str]
    horizons: list[str]
    rows: list[Row]
    together: list[tuple[str, ...]]
    recordings: list[tuple[str, str, list[Cell]]]
    left_out: list[str]


def predictions(record: Record, outputs: Sequence[Mapping[str, str]]) -> list[Predictions]:
    """Of each part of the log in the record, held-out data first; none for records of earlier versions."""
    found = record.prediction or {}
    return [_part(title, found[part], outputs) for part, title in PARTS.items() if found.get(part)]


def for_terminal(found: Predictions, most: int) -> list[list[str]]:
    """A table, its head first, of the last model by horizon and of the one before it in free run: the `most` outputs
    that are farthest above their floor. Angles are in degrees as well, in rows of their own.
    """
    before, _ = found.models[-2:]
    rows = [[f"open loop, {found.part}", *found.horizons, "times floor", f"{WHOLE}, {before}"]]
    for row in _farthest(found.rows, most):
        *_, whole = row.cells
        over = whole.over[-1].removesuffix(" ×")
        name = f"{row.name} [{row.unit}]" if row.unit else row.name
        rows.append([name, *(cell.values[-1] for cell in row.cells), over, whole.values[-2]])
        if whole.degrees:
            rows.append(["  in degrees", *(cell.degrees[-1] for cell in row.cells), "", whole.degrees[-2]])
    return rows


def _farthest(rows: Sequence[Row], most: int) -> list[Row]:
    """Those that are farthest above their floor in free run, as they come."""

    def over(row: Row) -> float:
        text = row.cells[-1].over[-1].removesuffix(" ×")
        return np.inf if text == DIVERGED else 0.0 if text == MISSING else float(text)

    farthest = sorted(rows, key=lambda row: -over(row))[:most]
    return [row for row in rows if row in farthest]


def _part(title: str, part: Mapping[str, Any], outputs: Sequence[Mapping[str, str]]) -> Predictions:
    horizons = part["horizons"]
    whole = horizons[-1]["models"]
    models = list(whole)
    shown = {o["name"]: _shown(o, [whole[m] for m in models]) for o in outputs}
    rows = [
        Row(o["name"], shown[o["name"]][1], [_cell(h["models"], o, shown[o["name"]][0]) for h in horizons])
        for o in outputs
    ]
    recordings = [
        (name, _seconds(runs["longest"]), [_cell(runs["models"], o, shown[o["name"]][0]) for o in outputs])
        for name, runs in part["recordings"].items()
    ]
    return Predictions(
        title,
        models,
        [_title(h) for h in horizons],
        rows,
        [tuple(_over(e["normalized"], e) for e in h["models"].values()) for h in horizons],
        recordings if len(recordings) > 1 else [],
        part["left_out"],
    )


def _title(row: Mapping[str, Any]) -> str:
    horizon = row["horizon"]
    return f"{WHOLE}, {_seconds(row['longest'])}" if horizon is None else f"{horizon:g}\u00a0s"


def _seconds(longest: float) -> str:
    return f"{significant(longest)}\u00a0s"


def _shown(output: Mapping[str, str], errors: Sequence[Mapping[str, Any]]) -> tuple[float, str]:
    """(factor, unit) in which errors of an output are shown: by that of the last model."""
    return scaled_unit(output["unit"], errors[-1]["rmse"].get(output["name"]))


def _cell(models: Mapping[str, Mapping[str, Any]], output: Mapping[str, str], factor: float) -> Cell:
    name, errors = output["name"], models.values()
    rmse = [e["rmse"].get(name) for e in errors]
    degrees = [_number(v, e, np.degrees(1.0)) for v, e in zip(rmse, errors, strict=True)]
    return Cell(
        tuple(_number(v, e, factor) for v, e in zip(rmse, errors, strict=True)),
        tuple(degrees) if output["unit"] == "rad" else (),
        tuple(_over(e["over_floor"].get(name), e) for e in errors),
    )


def _number(value: float | None, error: Mapping[str, Any], factor: float) -> str:
    return DIVERGED if error["diverged"] else significant(None if value is None else value * factor)


def _over(value: float | None, error: Mapping[str, Any]) -> str:
    return DIVERGED if error["diverged"] else with_unit(significant(value), "×")
