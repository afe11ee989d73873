"""`capture inspect`: its options, and what it prints."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from capture_cli.cli._inspection import show_inspection
from capture_cli.cli._results import fail_on
from capture_cli.options.base import Options
from capture_cli.options.shared import Json, MaxLogSize, OptionalTask, failing


@dataclass(frozen=True, kw_only=True)
class InspectOptions(Options):
    """path: of anything that `capture` wrote."""

    path: Annotated[Path, typer.Argument(help="A log, or any other output of `capture`.")]
    task: OptionalTask = None
    fail_on: frozenset[str] = failing("findings of this severity", "warning")
    max_log_size: MaxLogSize = None
    json_: Json = False


def inspect(options: InspectOptions) -> None:
    """Say what a file is and how healthy it is: gaps, NaN, rate, saturation, excitation.

    Example: capture inspect run.zarr --task task.toml
    """
    seen = show_inspection(options.path, options.task, options.max_log_size, as_json=options.json_)
    found = {f["severity"] for f in seen.findings}
    if "error" in found:
        raise typer.Exit(2)
    fail_on(found, options.fail_on)
