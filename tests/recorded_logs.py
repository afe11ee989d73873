"""Logs of simulated machines with effects in them, as `capture record` writes them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.log.measured_log import MeasuredLog
from capture_cli.stages.record import record


def record_log(folder: Path, task: Path, *effects: str, **options: Any) -> MeasuredLog:
    """The log of a machine with `effects`, at 250 Hz, written in `folder`. options: others of `record`."""
    record(task=str(task), out=folder / "log.zarr", effects=effects, rate=250.0, **options)
    return MeasuredLog.read(folder / "log.zarr")


def true_values(folder: Path) -> np.ndarray:
    """The parameters of the log in `folder`, those of its effects last."""
    truth = json.loads((folder / "log.truth.json").read_text(encoding="utf-8"))
    return np.array([*truth["parameters"].values(), *truth["effects"].values()])
