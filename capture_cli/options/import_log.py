"""Options of `capture import-log`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from capture_cli.options.shared import LogOut, MaxLogSize, Writing


@dataclass(frozen=True, kw_only=True)
class ImportLogOptions(Writing):
    """append: `out` is a log already, whose episodes come first."""

    files: Annotated[
        list[Path], typer.Argument(help="CSV or Parquet files, one recording each, or measured logs.")
    ]
    task: Annotated[str, typer.Option(help="Path of the task.toml that names the columns.")]
    out: LogOut
    drop_nan: Annotated[bool, typer.Option(help="Drop rows with missing values, inputs and all.")] = False
    drop_repeats: Annotated[
        bool, typer.Option(help="Drop rows that say the same as the row before, time and all.")
    ] = False
    drop_held: Annotated[
        bool, typer.Option(help="Empty the repeats of sparse outputs that hold each sample until the next.")
    ] = False
    even_times: Annotated[
        bool, typer.Option(help="Put samples at even intervals where their time stamps jitter about those.")
    ] = False
    append: Annotated[bool, typer.Option(help="Add the episodes to the log at --out, which exists.")] = False
    max_log_size: MaxLogSize = None
