"""What `capture inspect` shows, and `capture import-log` of the log that it wrote."""

import sys
from pathlib import Path

from capture_cli.cli._results import console, print_json
from capture_cli.store.inspection import Inspection


def show_inspection(
    path: Path, task: str | None, max_log_size: int | None, *, as_json: bool, quiet: bool = False
) -> Inspection:
    """The inspection, on stdout; if `quiet`, errors and warnings on stderr."""
    from capture_cli.stages.inspect import inspect as stage

    seen = stage(path, task, max_log_size)
    if as_json:
        print_json(seen.to_document())
    elif quiet:
        from capture_cli.report.inspection import complaints

        for message in complaints(seen):
            print(message, file=sys.stderr)
    else:
        from capture_cli.report.inspection import render

        render(seen, console())
    return seen
