"""The evaluation directory: evaluation.json (the tables), evaluation.zarr (every round of every pair), figures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capture_cli.store.document_shape import COUNT, EFFECTS, NUMBER, NUMBERS, TEXT, or_none
from capture_cli.store.result import DocumentKind, Keys, Result, Row, Rows
from capture_cli.store.schema import ArraySpec, Schema

FORMAT = "capture/evaluation"
VERSION = 4
BY_TRAJECTORY = "capture-trajectory"
_CURE = "make it again with `capture eval-sim2sim`"
SHAPE = {  # of what is read of evaluation.json
    "task": TEXT,
    "policy": TEXT,
    "effects": EFFECTS,
    "world": TEXT,
    "robot": or_none(TEXT),
    "noise": TEXT,
    "pairs": COUNT,
    "seeds": COUNT,
    "rounds": COUNT,
    "identifiers": {
        str: {
            "parameter_difference": {"mean": NUMBERS},
            "trajectory_difference": NUMBERS,
            "success": or_none([NUMBER]),
            "coverage?": or_none([NUMBER]),
        }
    },
}


def _named_by_its_tokens(found: Mapping[str, Any]) -> Mapping[str, Any]:
    """A document or attributes as of version 3: before, `capture` was the name of both networks."""
    rows = found.get("identifiers")
    if isinstance(rows, dict):
        renamed = (_by_trajectory(label, row) for label, row in rows.items())
        return {**found, "identifiers": dict(renamed)}
    if isinstance(rows, list):
        return {**found, "identifiers": [_labelled(row) for row in rows]}
    return found


def _labelled(row: Any) -> Any:
    if not isinstance(row, dict):
        return row
    label, row = _by_trajectory(row.get("label", ""), row)
    return {**row, "label": label}


def _by_trajectory(label: str, row: Any) -> tuple[str, Any]:
    """A label and what is said of it, under the name of today where it has a token per trajectory."""
    if not isinstance(row, dict) or (row.get("identifier"), row.get("tokens")) != ("capture", "trajectory"):
        return label, row
    return f"{BY_TRAJECTORY}{label.removeprefix('capture')}", {**row, "identifier": BY_TRAJECTORY}


EARLIER = {  # of a document or of attributes; before, no machine had effects, nor was one played in another world
    1: lambda found: {**found, "effects": []},
    2: _named_by_its_tokens,
    3: lambda found: {**found, "world": "plant", "robot": None},
}

_AXES = "identifier seed pair round"

SCHEMA = Schema(
    format="capture/evaluation-arrays",
    version=VERSION,
    arrays=(
        ArraySpec("source", "seed pair parameter", "per parameter", "where each pair begins"),
        ArraySpec("target", "seed pair parameter", "per parameter", "the truth"),
        ArraySpec(
            "estimates",
            f"{_AXES} parameter",
            "per parameter",
            "after so many rounds; the first is the source",
        ),
        ArraySpec("sd", f"{_AXES} parameter", "per parameter", "its standard deviation; NaN: not known"),
        ArraySpec(
            "trajectory_difference",
            _AXES,
            "per feature",
            "sum over the points of the distance between simulated (under the estimate) and measured (without noise), "
            "under the action that the policy chooses for the estimate",
        ),
        ArraySpec(
            "success",
            _AXES,
            "-",
            "whether that action succeeded under the truth",
            dtype="bool",
            optional=True,
        ),
        ArraySpec(
            "simulated_rollouts",
            _AXES,
            "1",
            "what the identifier has simulated, up to there, for the pair",
            dtype="int64",
        ),
    ),
    attributes={
        "task": "name of the task",
        "parameters": "list of {name, unit, low, high}, one per parameter",
        "features": "list of {name, unit, scale}, one per feature of a trajectory",
        "identifiers": "list of {label, identifier, checkpoint, sha256, ...}, one per identifier",
        "policy": "{name, sha256 of its checkpoint or null} of what chose the actions",
        "effects": "what the machines had beside the task's model; list as in capture/histories. Version 1 had none; "
        "of version 2 a `capture` with a token per trajectory is read as `capture-trajectory`",
        "world": "where machines were played: plant or robosuite",
        "robot": "null, or who did",
        "noise": "kind of noise in what identifiers were told was measured",
        "seed": "of every random choice",
    },
    cure_for_other_version=_CURE,
    earlier=EARLIER,
)


@dataclass(frozen=True, kw_only=True)
class EvaluationRecord(Keys):
    """evaluation.json, as reports read it."""

    task: str
    pairs: int
    seeds: int
    rounds: int
    policy: str
    noise: str
    parameters: Sequence[str]
    table_rounds: Sequence[int]
    yardstick: str | None
    identifiers: Rows
    effects: Sequence[Row] = ()
    world: str = "plant"
    robot: str | None = None


@dataclass(frozen=True, kw_only=True)
class SuiteRecord(Keys):
    """suite.json: the evaluations by the names of their cells, cells without checkpoints, and checkpoints in none."""

    cells: Rows
    without: Sequence[str]
    not_used: Sequence[str] = ()


class Evaluation(Result):
    """evaluation.json and evaluation.zarr."""

    NAME, SCHEMA = "evaluation", SCHEMA
    KIND = DocumentKind(FORMAT, VERSION, _CURE, SHAPE, EARLIER)


def joined(parts: list[Mapping[str, np.ndarray]], axis: str) -> dict[str, np.ndarray]:
    """Arrays of several evaluations as one, put after each other along the axis `axis`; others must agree."""
    result = {}
    for spec in SCHEMA.arrays:
        present = [p[spec.path] for p in parts if spec.path in p]
        if not present:
            continue
        along = axis in spec.dims
        result[spec.path] = np.concatenate(present, axis=spec.dims.index(axis)) if along else present[0]
    return result
