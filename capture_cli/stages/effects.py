"""`capture effects`: what a model may lack."""

from __future__ import annotations

from typing import Any

from capture_cli.effects import Entry, catalogue
from capture_cli.tasks import load_task


def describe(task: str | None) -> dict[str, Any]:
    """{"effects": [...]}: each effect with its parameters; with a task, its sites and its ranges in that model."""
    model = load_task(task).model if task else None
    return {"effects": [_one(entry, with_sites=task is not None) for entry in catalogue(model)]}


def _one(entry: Entry, *, with_sites: bool) -> dict[str, Any]:
    row = {"name": entry.name, "place": entry.place, "summary": entry.summary}
    if with_sites:
        row["sites"] = list(entry.sites)
    row["parameters"] = [
        {"name": p.name, "unit": p.unit, "low": p.low, "high": p.high, "null": p.nominal}
        for p in entry.parameters
    ]
    return row
