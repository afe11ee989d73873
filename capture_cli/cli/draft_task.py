"""`capture draft-task`: its options, and what it prints."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from capture_cli.cli._results import print_json
from capture_cli.options.base import option
from capture_cli.options.shared import Writing


@dataclass(frozen=True, kw_only=True)
class DraftTaskOptions(Writing):
    """log: whose columns are named; where None they are called like what they belong to."""

    model: Annotated[Path, typer.Argument(help="MJCF of the machine.")]
    log: Path | None = option(None, "CSV or Parquet file whose columns are named.")
    out: Path = option(Path("task.toml"), "Task file to write.")


def draft_task(options: DraftTaskOptions) -> None:
    """Write a first task file for a model, to go through by hand.

    Example: capture draft-task robot.xml --log run1.csv
    """
    from capture_cli.stages.draft_task import draft_task as stage

    draft = stage(model=options.model, out=options.out, log=options.log, force=options.force)
    if options.json_:
        print_json({**vars(draft), "task": str(draft.task), "model": str(draft.model)})
    elif not options.quiet:
        print(f"{draft.task}: written; {len(draft.parameters)} parameters, {len(draft.columns)} channels")
        if draft.model != options.model:
            print(f"{draft.model}: written; it is {options.model} with sensors of its joints")
        if draft.unused:
            print(f"columns that are not used: {', '.join(draft.unused)}")
        print(
            f"go through it, then: capture import-log {options.log or 'LOG.csv'} --task {draft.task} --out log.zarr"
        )
