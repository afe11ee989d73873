"""Inspections as `capture inspect --json` has them."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from capture_cli.stages.inspect import inspect as stage
from capture_cli.store.inspection import Inspection


def inspect(*arguments: Any, **options: Any) -> dict[str, Any]:
    """The JSON document of the inspection of a path."""
    return stage(*arguments, **options).to_document()


def as_inspection(document: dict[str, Any]) -> Inspection:
    """The record that was written as `document`."""
    values = {name: value for name, value in document.items() if name not in ("format", "version")}
    seen = Inspection(**{f.name: values.pop(f.name) for f in fields(Inspection) if f.init})
    for name, value in values.items():
        setattr(seen, name, value)
    return seen
