"""`capture effects`: its options, and what it prints."""

from __future__ import annotations

from capture_cli.commands._options import Json, OptionalTask
from capture_cli.commands._results import console, print_json


def effects(task: OptionalTask = None, json_: Json = False) -> None:
    """List the effects that a model may lack, with parameters, units and ranges.

    Example: capture effects --task task.toml
    """
    from capture_cli.stages.effects import describe

    document = describe(task)
    if json_:
        print_json(document)
    else:
        from capture_cli.reports.listing import print_effects

        print_effects(document, console())
