"""`capture inspect`: its options, and what it prints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture_cli.cli._config import Config
from capture_cli.cli._inspection import show_inspection
from capture_cli.cli._options import Json, MaxLogSize, OptionalTask, fail_on_option
from capture_cli.cli._texts import chosen

SEVERITIES = ("warning",)  # that --fail-on may name


def inspect(
    path: Annotated[Path, typer.Argument(help="A log, or any other output of `capture`.")],
    task: OptionalTask = None,
    fail_on: Annotated[str | None, fail_on_option("findings of this severity", SEVERITIES)] = None,
    max_log_size: MaxLogSize = None,
    json_: Json = False,
    config: Config = None,
) -> None:
    """Say what a file is and how healthy it is: gaps, NaN, rate, saturation, excitation.

    Example: capture inspect run.zarr --task task.toml
    """
    severities = chosen(fail_on, *SEVERITIES)
    document = show_inspection(path, task, json_, quiet=False, max_log_size=max_log_size)
    found = {f["severity"] for f in document["findings"]}
    if "error" in found:
        raise typer.Exit(2)
    if found & severities:
        raise typer.Exit(3)
