"""A log as plain arrays: it is cut into windows; motion, initial states and noise are read off it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


def slices_until(ends: Sequence[int]) -> list[slice]:
    """The steps of each episode, of those that end before `ends` (episode,)."""
    ends = [int(e) for e in ends]
    return [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]


@dataclass(frozen=True)
class Log:
    """SI units. time (step,); outputs (step, output); episodes: the steps of each; inputs (step, input): none by
    default.

    sampled (step, output): where outputs have a sample, by default everywhere.
    """

    time: np.ndarray
    outputs: np.ndarray
    episodes: Sequence[slice]
    inputs: Any = None
    sampled: Any = None

    def __post_init__(self):
        if self.inputs is None:
            object.__setattr__(self, "inputs", np.zeros((len(self.time), 0)))
        if self.sampled is None:
            object.__setattr__(self, "sampled", np.ones(self.outputs.shape, dtype=bool))
