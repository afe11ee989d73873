"""`capture tasks`: its options, and what it prints."""

from __future__ import annotations

from capture_cli.cli._options import Json, OptionalTask
from capture_cli.cli._results import console, print_json


def tasks(task: OptionalTask = None, json_: Json = False) -> None:
    """List the built-in tasks, or the parameters, inputs and outputs of one.

    Example: capture tasks --task task.toml
    """
    from capture_cli.stages.tasks import describe

    document = describe(task)
    if json_:
        print_json(document)
    else:
        from capture_cli.report.listing import print_tasks

        print_tasks(document, console())
