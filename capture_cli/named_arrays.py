"""Arrays of several things under one set of names: PART.NAME."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


def by_part(arrays: Mapping[str, np.ndarray]) -> dict[str, dict[str, np.ndarray]]:
    """Arrays named PART.NAME, by part and name; of a name without a point the name is empty."""
    parts: dict[str, dict[str, np.ndarray]] = {}
    for key, array in arrays.items():
        part, _, name = key.partition(".")
        parts.setdefault(part, {})[name] = array
    return parts
