"""The diagnosis directory: diagnosis.json (what the model lacks), diagnosis.zarr (the curves), report and figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.stores.estimate import read_result
from capture_cli.stores.provenance import write_json
from capture_cli.stores.schema import STARTS, ArraySpec, Schema

FORMAT = "capture/diagnosis"
VERSION = 1
_CURE = "make it again with `capture diagnose`"

SCHEMA = Schema(
    format="capture/diagnosis-arrays",
    version=1,
    arrays=(
        ArraySpec("window/episode", ("window",), "int64", "-", "episode each window comes from"),
        ArraySpec("window/first", ("window",), "int64", "steps", "first step of each window in the log"),
        ArraySpec("window/part", ("window",), "int64", "-", "0 fit, 1 select, 2 test"),
        *STARTS,
        ArraySpec(
            "window/start_hidden",
            ("window", "hidden"),
            "float64",
            "1",
            "with which `states` of the effects of diagnosis.json, one after the other",
            optional=True,
        ),
        ArraySpec("step/window", ("step",), "int64", "-", "window each step belongs to"),
        ArraySpec("step/time", ("step",), "float64", "s", "time of each step, on the log's clock"),
        ArraySpec("step/measured", ("step", "output"), "float64", "per output", "measured; NaN: no sample"),
        ArraySpec(
            "step/before",
            ("step", "output"),
            "float64",
            "per output",
            "simulated by the declared model, refitted",
        ),
        ArraySpec(
            "step/after", ("step", "output"), "float64", "per output", "simulated with the accepted effects"
        ),
        ArraySpec(
            "bin/centre", ("curve", "bin"), "float64", "per curve", "covariate at the middle of each bin"
        ),
        ArraySpec(
            "bin/before",
            ("curve", "bin"),
            "float64",
            "per curve",
            "mean residual acceleration, declared model",
        ),
        ArraySpec(
            "bin/after", ("curve", "bin"), "float64", "per curve", "mean residual acceleration, with effects"
        ),
        ArraySpec(
            "bin/error", ("curve", "bin"), "float64", "per curve", "standard error of `before` in each bin"
        ),
    ),
    attributes={
        "outputs": "list of {name, unit}",
        "recordings": "recording names",
        "curves": "list of {output, against, unit, share}: what each curve of residual acceleration is against, and "
        "the share of its variance that the covariate accounts for",
    },
    cure_for_other_version=_CURE,
)


@dataclass(frozen=True)
class Diagnosis:
    """diagnosis.json as a dict (`document`) and the arrays of diagnosis.zarr by path."""

    document: dict[str, Any]
    arrays: dict[str, np.ndarray]
    attributes: dict[str, Any]

    def write(self, folder: Path) -> None:
        write_json(folder / "diagnosis.json", self.document)
        SCHEMA.write(folder / "diagnosis.zarr", self.arrays, self.attributes)

    @classmethod
    def read(cls, folder: Path) -> Diagnosis:
        """The diagnosis in `folder`. Raises StoreError where it is none, damaged or of another version."""
        document = read_result(Path(folder), "diagnosis.json", FORMAT, VERSION, _CURE)
        arrays, attributes = SCHEMA.read(Path(folder) / "diagnosis.zarr")
        return cls(dict(document), arrays, attributes)
