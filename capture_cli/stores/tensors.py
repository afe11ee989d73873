"""Named arrays in a safetensors file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from capture_cli.errors import StoreError

LENGTH = 8  # bytes, little-endian, before the header: how many it has
LONGEST_HEADER = 100_000_000  # bytes that safetensors takes for one


def save_arrays(
    path: Path, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str] | None = None
) -> None:
    """Write `arrays` to `path`, each with its elements in order.

    safetensors writes memory as it lies: of a transposed array that is another array.
    """
    from safetensors.numpy import save

    whole = {name: np.ascontiguousarray(array) for name, array in sorted(arrays.items())}
    # not by its save_file, which lets nobody but the owner read the file
    path.write_bytes(save(whole, None if metadata is None else dict(metadata)))


def read_arrays(path: Path, cure: str) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """The arrays of `path`, and its metadata. Raises StoreError, with `cure`, where it is missing or damaged."""
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise StoreError(f"{path.parent} holds no {path.name}", cure=cure)
    try:
        size, least = path.stat().st_size, _least_size(path)
        if size < least:
            raise StoreError(
                f"{path} cannot be read: it was cut short to {size} bytes, of at least {least}",
                cure=f"copy it again from where it is whole, or {cure}",
            )
        with safe_open(path, framework="numpy") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, dict(file.metadata() or {})  # noqa: SIM118
    except (OSError, SafetensorError) as error:
        raise StoreError(f"{path} cannot be read: {error}", cure=cure) from error


def _least_size(path: Path) -> int:
    """How many bytes the file at `path` must have, by its header, or by that header's length where it is cut short
    itself; 0 where there is nothing like a header.
    """
    with path.open("rb") as file:
        length = int.from_bytes(file.read(LENGTH), "little")
        if length > LONGEST_HEADER:
            return 0
        try:
            header = json.loads(file.read(length))
            ends = [entry["data_offsets"][1] for name, entry in header.items() if name != "__metadata__"]
            return LENGTH + length + max(ends, default=0)
        except (ValueError, AttributeError, KeyError, TypeError, IndexError):
            return LENGTH + length
