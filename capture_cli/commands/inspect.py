"""`capture inspect`: its options, and what it prints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture_cli.commands._config import Config
from capture_cli.commands._inspection import show_inspection
from capture_cli.commands._options import Json, OptionalTask


def inspect(
    path: Annotated[Path, typer.Argument(help="A log, or any other output of `capture`.")],
    task: OptionalTask = None,
    json_: Json = False,
    config: Config = None,
) -> None:
    """Say what a file is and how healthy it is: gaps, NaN, rate, saturation, excitation.

    Example: capture inspect run.zarr --task task.toml
    """
    document = show_inspection(path, task, json_, quiet=False)
    if any(f["severity"] == "error" for f in document["findings"]):
        raise typer.Exit(2)
