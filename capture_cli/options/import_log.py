"""Options of `capture import-log`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from capture_cli.options.base import option
from capture_cli.options.shared import LogOut, MaxLogSize, Writing


@dataclass(frozen=True, kw_only=True)
class ImportLogOptions(Writing):
    """append: `out` is a log already, whose episodes come first."""

    files: Annotated[
        list[Path], typer.Argument(help="CSV or Parquet files, one recording each, or measured logs.")
    ]
    task: str = option(..., "Path of the task.toml that names the columns.")
    out: LogOut
    drop_nan: bool = option(False, "Drop rows with missing values, inputs and all.")
    drop_repeats: bool = option(False, "Drop rows that say the same as the row before, time and all.")
    drop_held: bool = option(
        False, "Empty the repeats of sparse outputs that hold each sample until the next."
    )
    even_times: bool = option(
        False, "Put samples at even intervals where their time stamps jitter about those."
    )
    append: bool = option(False, "Add the episodes to the log at --out, which exists.")
    max_log_size: MaxLogSize = None
