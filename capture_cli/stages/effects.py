"""`capture effects`: what a model may lack."""

from typing import Any

from capture_cli.model.effects import REGISTRY, Entry, catalogue
from capture_cli.model.tasks import load_task


def describe(task: str | None, name: str | None = None) -> list[dict[str, Any]]:
    """Each effect with its law and parameters; with a task, its sites and its ranges in that model.

    name: of the one that is asked for, where not all. Raises OptionError where there is none of that name.
    """
    if name is not None:
        REGISTRY.get(name)
    model = load_task(task).model if task else None
    entries = [entry for entry in catalogue(model) if name in (None, entry.name)]
    return [_one(entry, with_sites=task is not None) for entry in entries]


def _one(entry: Entry, *, with_sites: bool) -> dict[str, Any]:
    kind = entry.kind
    row = {
        "name": entry.name,
        "place": kind.place,
        "summary": kind.summary,
        "law": kind.law(),
        "where": kind.where,
        "exported_as": kind.exported_as(),
    }
    if with_sites:
        row["sites"] = list(entry.sites)
    row["parameters"] = [
        {
            "name": p.name,
            "unit": p.unit,
            "low": p.low,
            "high": p.high,
            "null": p.nominal,
            "shape": p.name in kind.shapes,
        }
        for p in entry.parameters
    ]
    return row
