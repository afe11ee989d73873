"""Errors in open loop by prediction horizon, as result files have them."""

from __future__ import annotations

from typing import Any

import numpy as np

from capture_cli.estimate.prediction import Predicted, PredictionError, PredictionErrors, Runs
from capture_cli.estimate.prepared_log import PreparedLog


def prediction_of(prepared: PreparedLog, found: Predicted) -> dict[str, Any]:
    """The errors of each part by its name: by horizon, and of each recording in free run; None of one that is empty."""
    return {name: None if part is None else _part(prepared, part) for name, part in found.items()}


def _part(prepared: PreparedLog, found: PredictionErrors) -> dict[str, Any]:
    *_, free_runs = found.predictions
    return {
        "horizons": [{"horizon": p.horizon, **_runs(prepared, p.runs)} for p in found.predictions],
        "recordings": {name: _runs(prepared, runs) for name, runs in free_runs.recordings.items()},
        "left_out": found.left_out,
    }


def _runs(prepared: PreparedLog, runs: Runs) -> dict[str, Any]:
    models = {name: _error(prepared, error) for name, error in runs.errors.items()}
    return {"runs": runs.count, "longest": runs.longest, "models": models}


def _error(prepared: PreparedLog, error: PredictionError) -> dict[str, Any]:
    return {
        "rmse": by_output(prepared, error.rmse),
        "over_floor": by_output(prepared, error.rmse / prepared.noise.sd),
        "normalized": None if error.diverged else error.normalized,
        "diverged": error.diverged,
    }


def by_output(prepared: PreparedLog, errors: np.ndarray) -> dict[str, float | None]:
    """Errors (output,) by the names of the outputs; None of those that are nan."""
    names = [c.name for c in prepared.task.outputs]
    return {n: None if np.isnan(e) else float(e) for n, e in zip(names, errors, strict=True)}
