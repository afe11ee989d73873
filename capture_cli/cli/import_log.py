"""`capture import-log`: its help, and what it prints."""

from capture_cli.cli._inspection import show_inspection
from capture_cli.options.import_log import ImportLogOptions


def import_log(options: ImportLogOptions) -> None:
    """Read CSV or Parquet files into a measured log.

    Example: capture import-log run1.csv run2.csv --task task.toml --out runs.zarr
    """
    from capture_cli.stages.import_log import import_log as stage

    stage(options)
    show_inspection(
        options.out, options.task, options.max_log_size, as_json=options.json_, quiet=options.quiet
    )
