"""The estimate directory: estimate.json (what was found), estimate.zarr (the curves), report.html and figures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.errors import StoreError
from capture_cli.stores.provenance import write_json
from capture_cli.stores.schema import STARTS, ArraySpec, Schema

FORMAT = "capture/estimate"
VERSION = 1
_CURE = "make it again with `capture identify`"
# the rounds in context, as an identifier reads them
HISTORY = ("history/parameters", "history/actions", "history/simulated", "history/measured")
_POINTS = ("entry", "point", "feature")

SCHEMA = Schema(
    format="capture/estimate-arrays",
    version=1,
    arrays=(
        ArraySpec("window/episode", ("window",), "int64", "-", "episode each window comes from"),
        ArraySpec("window/first", ("window",), "int64", "steps", "first step of each window in the log"),
        ArraySpec("window/is_test", ("window",), "bool", "-", "True: held out; only its start is fitted"),
        ArraySpec("window/start_offset", ("window", "state"), "float64", "SI", "refinement of the start"),
        *STARTS,
        ArraySpec("step/window", ("step",), "int64", "-", "window each step belongs to"),
        ArraySpec("step/time", ("step",), "float64", "s", "time of each step, on the log's clock"),
        ArraySpec("step/measured", ("step", "output"), "float64", "per output", "measured; NaN: no sample"),
        ArraySpec("step/simulated", ("step", "output"), "float64", "per output", "simulated at the estimate"),
        ArraySpec(
            "step/nominal", ("step", "output"), "float64", "per output", "simulated at the nominal values"
        ),
        ArraySpec("parameter/estimate", ("parameter",), "float64", "per parameter", "the estimate"),
        ArraySpec(
            "parameter/covariance", ("parameter", "parameter"), "float64", "per parameter", "its covariance"
        ),
        ArraySpec(
            "parameter/recordings",
            ("recording", "parameter"),
            "float64",
            "per parameter",
            "from each alone",
            optional=True,
        ),
        ArraySpec(
            "parameter/recordings_sd",
            ("recording", "parameter"),
            "float64",
            "per parameter",
            "their sd",
            optional=True,
        ),
        ArraySpec("round/parameters", ("round", "parameter"), "float64", "per parameter", "best so far"),
        ArraySpec("round/error", ("round",), "float64", "1", "normalized fit error of the best so far"),
        ArraySpec(
            HISTORY[0],
            ("entry", "parameter"),
            "float64",
            "per parameter",
            "rounds in context: simulated with",
            optional=True,
        ),
        ArraySpec(
            HISTORY[1], ("entry", "action"), "float64", "per action", "under this action", optional=True
        ),
        ArraySpec(HISTORY[2], _POINTS, "float64", "per feature", "the trajectory simulated", optional=True),
        ArraySpec(HISTORY[3], _POINTS, "float64", "per feature", "the one measured", optional=True),
    ),
    attributes={
        "parameters": "parameter names",
        "outputs": "list of {name, unit}",
        "recordings": "recording names",
    },
    cure_for_other_version=_CURE,
)


@dataclass(frozen=True)
class Estimate:
    """estimate.json as a dict (`document`) and the arrays of estimate.zarr by path."""

    document: dict[str, Any]
    arrays: dict[str, np.ndarray]
    attributes: dict[str, Any]

    def write(self, folder: Path) -> None:
        write_json(folder / "estimate.json", self.document)
        SCHEMA.write(folder / "estimate.zarr", self.arrays, self.attributes)

    @classmethod
    def read(cls, folder: Path) -> Estimate:
        """The estimate in `folder`. Raises StoreError where it is none, damaged or of another version."""
        document = read_result(Path(folder), "estimate.json", FORMAT, VERSION, _CURE)
        arrays, attributes = SCHEMA.read(Path(folder) / "estimate.zarr")
        return cls(document, arrays, attributes)


def read_result(folder: Path, name: str, form: str, version: int, cure: str) -> Mapping[str, Any]:
    """The JSON document `name` of a result directory. Raises StoreError where it is not one of `form`."""
    path = folder / name
    if not folder.exists():
        raise StoreError(f"{folder} does not exist", cure="check the path")
    if not path.is_file():
        raise StoreError(f"{folder} holds no {name}", cure=f"give the directory that holds it; {cure}")
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise StoreError(f"{path} is not JSON: {error}", cure=cure) from error
    if not isinstance(document, dict) or document.get("format") != form:
        raise StoreError(f"{path} is not of the format {form}", cure=cure)
    if document.get("version") != version:
        raise StoreError(
            f"{path}: {form} version {document.get('version')!r}; this program reads {version}", cure=cure
        )
    return document
