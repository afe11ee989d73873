"""`capture tasks`: its options, and what it prints."""

from dataclasses import dataclass

from capture_cli.cli._results import console, print_json
from capture_cli.options.base import Options
from capture_cli.options.shared import Json, OptionalTask


@dataclass(frozen=True, kw_only=True)
class TasksOptions(Options):
    """task: all that are built in where None."""

    task: OptionalTask = None
    json_: Json = False


def tasks(options: TasksOptions) -> None:
    """List the built-in tasks, or the parameters, inputs and outputs of one.

    Example: capture tasks --task task.toml
    """
    from capture_cli.stages.tasks import describe

    found = describe(options.task)
    if options.json_:
        print_json({"tasks": found})
    else:
        from capture_cli.report.listing import print_tasks

        print_tasks(found, console())
