"""Named arrays in a safetensors file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np


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
