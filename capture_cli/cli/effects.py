"""`capture effects`: its options, and what it prints."""

from dataclasses import dataclass
from typing import Annotated

import typer

from capture_cli.cli._results import console, print_json
from capture_cli.options.base import Options
from capture_cli.options.completion import effects as names_of_effects
from capture_cli.options.shared import Json, OptionalTask


@dataclass(frozen=True, kw_only=True)
class EffectsOptions(Options):
    """name: all effects where None."""

    name: Annotated[
        str | None,
        typer.Argument(help="Of one effect: its law, and where it sits.", autocompletion=names_of_effects),
    ] = None
    task: OptionalTask = None
    json_: Json = False


def effects(options: EffectsOptions) -> None:
    """List the effects that a model may lack, or the law, sites, units and ranges of one.

    Example: capture effects --task task.toml
    """
    from capture_cli.stages.effects import describe

    found = describe(options.task, options.name)
    if options.json_:
        print_json({"effects": found})
    else:
        from capture_cli.report.listing import print_effect, print_effects

        if options.name is None:
            print_effects(found, console())
        else:
            print_effect(found[0], console())
