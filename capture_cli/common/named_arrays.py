"""Arrays by name: of several things under one set of names, PART.NAME; and the shapes that they have to have."""

from collections.abc import Mapping

import numpy as np


def by_part(arrays: Mapping[str, np.ndarray]) -> dict[str, dict[str, np.ndarray]]:
    """Arrays named PART.NAME, by part and name; of a name without a point the name is empty."""
    parts: dict[str, dict[str, np.ndarray]] = {}
    for key, array in arrays.items():
        part, _, name = key.partition(".")
        parts.setdefault(part, {})[name] = array
    return parts


def check_shapes(arrays: Mapping[str, np.ndarray], expected: Mapping[str, tuple[int, ...]]) -> None:
    """Raise ValueError, which names the first array that is not of the shape `expected`, is missing, or is one more."""
    for name, shape in expected.items():
        if name not in arrays:
            raise ValueError(f"{name} is missing, expected of shape {shape}")
        if arrays[name].shape != shape:
            raise ValueError(f"{name} has shape {arrays[name].shape}, expected {shape}")
    if more := sorted(arrays.keys() - expected.keys()):
        raise ValueError(f"{more[0]} is one array more than there should be")
