"""The evaluation directory: evaluation.json (the tables), evaluation.zarr (every round of every pair), figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.stores.estimate import read_result
from capture_cli.stores.provenance import write_json
from capture_cli.stores.schema import ArraySpec, Schema

FORMAT = "capture/evaluation"
VERSION = 1
DOCUMENT, ARRAYS = "evaluation.json", "evaluation.zarr"
_CURE = "make it again with `capture eval-sim2sim`"
_AXES = ("identifier", "seed", "pair", "round")

SCHEMA = Schema(
    format="capture/evaluation-arrays",
    version=1,
    arrays=(
        ArraySpec(
            "source", ("seed", "pair", "parameter"), "float64", "per parameter", "where each pair begins"
        ),
        ArraySpec("target", ("seed", "pair", "parameter"), "float64", "per parameter", "the truth"),
        ArraySpec(
            "estimates",
            (*_AXES, "parameter"),
            "float64",
            "per parameter",
            "after so many rounds; the first is the source",
        ),
        ArraySpec(
            "sd", (*_AXES, "parameter"), "float64", "per parameter", "its standard deviation; NaN: not known"
        ),
        ArraySpec(
            "trajectory_difference",
            _AXES,
            "float64",
            "per feature",
            "sum over the points of the distance between simulated (under the estimate) and measured (without noise), "
            "under the action that the policy chooses for the estimate",
        ),
        ArraySpec(
            "success", _AXES, "bool", "-", "whether that action succeeded under the truth", optional=True
        ),
        ArraySpec(
            "simulated_rollouts",
            _AXES,
            "int64",
            "1",
            "what the identifier has simulated, up to there, for the pair",
        ),
    ),
    attributes={
        "task": "name of the task",
        "parameters": "list of {name, unit, low, high}, one per parameter",
        "features": "list of {name, unit, scale}, one per feature of a trajectory",
        "identifiers": "list of {label, identifier, checkpoint, sha256, ...}, one per identifier",
        "policy": "{name, sha256 of its checkpoint or null} of what chose the actions",
        "noise": "kind of noise in what identifiers were told was measured",
        "seed": "of every random choice",
    },
    cure_for_other_version=_CURE,
)


@dataclass(frozen=True)
class Evaluation:
    """evaluation.json as a dict (`document`) and the arrays of evaluation.zarr by path."""

    document: dict[str, Any]
    arrays: dict[str, np.ndarray]
    attributes: dict[str, Any]

    def write(self, folder: Path) -> None:
        write_json(folder / DOCUMENT, self.document)
        SCHEMA.write(folder / ARRAYS, self.arrays, self.attributes)

    @classmethod
    def read(cls, folder: Path) -> Evaluation:
        """The evaluation in `folder`. Raises StoreError where it is none, damaged or of another version."""
        document = read_result(Path(folder), DOCUMENT, FORMAT, VERSION, _CURE)
        arrays, attributes = SCHEMA.read(Path(folder) / ARRAYS)
        return cls(dict(document), arrays, attributes)


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
