"""`capture effects`: its options, and what it prints."""

from __future__ import annotations

from typing import Annotated

import typer

from capture_cli.cli._completion import effects as names_of_effects
from capture_cli.cli._options import Json, OptionalTask
from capture_cli.cli._results import console, print_json

Name = Annotated[
    str | None,
    typer.Argument(help="Of one effect: its law, and where it sits.", autocompletion=names_of_effects),
]


def effects(name: Name = None, task: OptionalTask = None, json_: Json = False) -> None:
    """List the effects that a model may lack, or the law, sites, units and ranges of one.

    Example: capture effects --task task.toml
    """
    from capture_cli.stages.effects import describe

    document = describe(task, name)
    if json_:
        print_json(document)
    else:
        from capture_cli.report.listing import print_effect, print_effects

        if name is None:
            print_effects(document, console())
        else:
            print_effect(document["effects"][0], console())
