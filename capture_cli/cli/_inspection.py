"""What `capture inspect` shows, and `capture import-log` of the log that it wrote."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from capture_cli.cli._results import console, print_json


def show_inspection(
    path: Path, task: str | None, max_log_size: int | None, *, as_json: bool, quiet: bool = False
) -> dict[str, Any]:
    """The inspection, on stdout; if `quiet`, what must not go unseen on stderr."""
    from capture_cli.stages.inspect import inspect as stage

    document = stage(path, task, max_log_size)
    if as_json:
        print_json(document)
    elif quiet:
        from capture_cli.report.inspection import complaints

        for message in complaints(document):
            print(message, file=sys.stderr)
    else:
        from capture_cli.report.inspection import render

        render(document, console())
    return document
