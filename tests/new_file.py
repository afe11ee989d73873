"""A file to write that becomes another, as `new_outputs` has it of one output."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from capture_cli.store.output import New, new_outputs


@contextmanager
def new_file(path: Path, *, force: bool = False) -> Iterator[Path]:
    """Where to write it until the block ends without an error."""
    with new_outputs(New(path), force=force) as (partial,):
        yield partial
