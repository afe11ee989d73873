"""How fast several ways of stepping are, measured in turns: what else the machine does slows all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np


def interleaved(kinds: Mapping[str, Callable[[], float]], repeats: int) -> dict[str, np.ndarray]:
    """Steps per CPU second of each, (repeat,), one after the other in every repeat; each returns its steps."""
    speeds: dict[str, list[float]] = {name: [] for name in kinds}
    for run in kinds.values():
        run()  # first calls load libraries and touch memory
    for _ in range(repeats):
        for name, run in kinds.items():
            began = time.process_time()
            steps = run()
            speeds[name].append(steps / (time.process_time() - began))
    return {name: np.array(s) for name, s in speeds.items()}
