"""What a single file is that `capture inspect` is given: JSON of `capture`, or what other command reads it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from capture_cli.common.documents import read_json
from capture_cli.errors import StoreError
from capture_cli.log.readers import readers

_OTHERS = {
    ".toml": "a task.toml is read by `capture tasks --task {path}`",
    ".xml": "a model is read with the task.toml that names it: `capture tasks --task task.toml`",
}
_READ_IN = "read it in first: `capture import-log {path} --task task.toml --out NAME.zarr`"


def read_header(path: Path) -> Mapping[str, Any]:
    """The top of a JSON file that `capture` wrote: format, version, and what else it has.

    Raises StoreError, naming what reads it where something does, for any other file.
    """
    with suppress(StoreError):
        document = read_json(path, StoreError, cure="")
        if isinstance(document, dict) and str(document.get("format")).startswith("capture/"):
            return document
    others = _OTHERS | dict.fromkeys(readers(), _READ_IN)
    otherwise = "give a log (.zarr), an estimate, a diagnosis or another output of `capture`"
    raise StoreError(
        f"{path} is a file, and neither a Zarr store nor JSON that `capture` wrote",
        cure=others.get(path.suffix.lower(), otherwise).format(path=path),
    )
