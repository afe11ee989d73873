"""Which kinds of input there are: a module for each, with `seeds(inputs)` and `cases(inputs)`."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

from fuzz import (
    command_options,
    csv_files,
    json_documents,
    models,
    parquet_files,
    surroundings,
    task_files,
    weights,
    zarr_stores,
)
from fuzz.cases import Case

KINDS: dict[str, ModuleType] = {
    "csv": csv_files,
    "parquet": parquet_files,
    "task": task_files,
    "model": models,
    "zarr": zarr_stores,
    "json": json_documents,
    "safetensors": weights,
    "options": command_options,
    "surroundings": surroundings,
}


def seeds(inputs: Path) -> dict[str, list[Case]]:
    """The inputs whose end is known, by their kind."""
    return {kind: module.seeds(inputs) for kind, module in KINDS.items() if hasattr(module, "seeds")}
