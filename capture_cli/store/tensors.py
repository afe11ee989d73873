"""Named arrays in a safetensors file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.common.documents import SETTINGS as DOCUMENTS
from capture_cli.common.documents import check_file, open_file, parse_json
from capture_cli.common.frozen import frozen
from capture_cli.errors import StoreError


@frozen
class SETTINGS:
    length: int = 8  # bytes, little-endian, before the header: how many it has
    largest_weight: float = 1e4  # of a network that was trained; those that are shipped have none above 2


METADATA = "__metadata__"


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
    size, least = check_file(path, StoreError), _least_size(path, cure)
    if size < least:
        raise StoreError(
            f"{path} cannot be read: it was cut short to {size} bytes, of at least {least}",
            cure=f"copy it again from where it is whole, or {cure}",
        )
    try:
        with safe_open(path, framework="numpy") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, dict(file.metadata() or {})  # noqa: SIM118
    except (OSError, SafetensorError, TypeError, ValueError) as error:
        # numpy has not all its types of numbers
        raise StoreError(f"{path} cannot be read: {error}", cure=cure) from error


def read_weights(path: Path, cure: str, network: str = "") -> dict[str, np.ndarray]:
    """What was trained, in `path`: arrays of floating point, of which those of a network begin with `network`.

    Raises StoreError, with `cure`, where one is of other numbers, or a network's are not what a training ends with.
    """
    arrays, _ = read_arrays(path, cure)
    for name, array in arrays.items():
        if array.dtype.kind != "f":
            raise StoreError(f"{path}: {name} is of type {array.dtype}; expected floating point", cure=cure)
        if not np.isfinite(array).all():
            raise StoreError(f"{path}: {name} is not finite", cure=cure)
        wrong = np.flatnonzero((np.abs(array) > SETTINGS.largest_weight) & name.startswith(network))
        if wrong.size:
            raise StoreError(
                f"{path}: {name} holds {array.ravel()[wrong[0]]:g}, which no training ends with; the most that is "
                f"believed is {SETTINGS.largest_weight:g}",
                cure=cure,
            )
    return arrays


def _least_size(path: Path, cure: str) -> int:
    """How many bytes the file at `path` must have, by its header, or by that header's length where it is cut short
    itself. Raises StoreError where there is nothing like a header.
    """
    with open_file(path, StoreError) as file:
        length = int.from_bytes(file.read(SETTINGS.length), "little")
        if length > DOCUMENTS.largest_json:
            raise StoreError(
                f"{path} cannot be read: its header would have {length} bytes, and {DOCUMENTS.largest_json} are "
                "the most",
                cure=cure,
            )
        text = file.read(length)
    if len(text) < length:
        return SETTINGS.length + length
    header = parse_json(text, f"{path}: its header", StoreError, cure=cure)
    entries = header.items() if isinstance(header, dict) else ()
    ends = [_end(entry) for name, entry in entries if name != METADATA]
    return SETTINGS.length + length + max(ends, default=0)


def _end(entry: Any) -> int:
    """Where the array of an entry of the header ends, bytes; 0 where it does not say, which safetensors will."""
    try:
        return int(entry["data_offsets"][1])
    except (KeyError, TypeError, ValueError, IndexError):
        return 0
