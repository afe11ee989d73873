"""A file of JSON lines that work adds to as it goes, so that it can be stopped and taken up again."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any


def read(path: Path) -> list[dict[str, Any]]:
    """The lines of the file, none where there is no file; one that was cut off is left out."""
    if not path.is_file():
        return []
    found = []
    for text in path.read_text(encoding="utf-8").splitlines():
        try:
            found.append(json.loads(text))
        except ValueError:
            continue  # cut off when the work was stopped
    return found


def append(path: Path, line: dict[str, Any]) -> None:
    """Add a line, on one of its own even where the last was cut off. Raises ValueError for nan and inf."""
    text = json.dumps(line, allow_nan=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+b") as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - 1))
        cut_off = file.read(1) not in (b"", b"\n")
        file.write(("\n" * cut_off + text + "\n").encode())
