"""`capture import-log`: its options, and what it prints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture_cli.cli._config import Config
from capture_cli.cli._inspection import show_inspection
from capture_cli.cli._options import Force, Json, LogOut, MaxLogSize, Quiet


def import_log(
    files: Annotated[
        list[Path], typer.Argument(help="CSV or Parquet files, one recording each, or measured logs.")
    ],
    task: Annotated[str, typer.Option("--task", help="Path of the task.toml that names the columns.")],
    out: LogOut,
    drop_nan: Annotated[
        bool, typer.Option("--drop-nan", help="Drop rows with missing values, inputs and all.")
    ] = False,
    drop_repeats: Annotated[
        bool,
        typer.Option("--drop-repeats", help="Drop rows that say the same as the row before, time and all."),
    ] = False,
    drop_held: Annotated[
        bool,
        typer.Option(
            "--drop-held", help="Empty the repeats of sparse outputs that hold each sample until the next."
        ),
    ] = False,
    even_times: Annotated[
        bool,
        typer.Option(
            "--even-times", help="Put samples at even intervals where their stamps scatter about those."
        ),
    ] = False,
    append: Annotated[
        bool, typer.Option("--append", help="Add the episodes to the log at --out, which exists.")
    ] = False,
    max_log_size: MaxLogSize = None,
    force: Force = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Read CSV or Parquet files into a measured log.

    Example: capture import-log run1.csv run2.csv --task task.toml --out runs.zarr
    """
    from capture_cli.stages.import_log import import_log as stage

    mended = {
        "drop_nan": drop_nan,
        "drop_repeats": drop_repeats,
        "drop_held": drop_held,
        "even_times": even_times,
    }
    stage(files=files, task=task, out=out, append=append, force=force, max_log_size=max_log_size, **mended)
    show_inspection(out, task, json_, quiet, max_log_size)
