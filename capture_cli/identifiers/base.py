"""What an identifier is: it asks for simulations, is told what they gave, and says what is best so far."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from capture_cli.parameters import ParameterSpace


@dataclass(frozen=True)
class Evidence:
    """What was measured, as arrays.

    measured (window, step, output); mask (window, step), False for padding. noise_sd (output,): the noise floor,
    which weighs outputs against each other. start_sd (window, state): how well each start is known beforehand;
    0 where it may not be moved.
    """

    space: ParameterSpace
    measured: np.ndarray
    mask: np.ndarray
    noise_sd: np.ndarray
    start_sd: np.ndarray

    @property
    def count(self) -> int:
        """How many numbers were measured."""
        return int(self.mask.sum()) * self.measured.shape[-1]

    def residual(self, outputs: np.ndarray) -> np.ndarray:
        """Measured minus simulated (..., window, step, output), in units of the noise, as (..., window, row)."""
        residual = (self.measured - outputs) / self.noise_sd * self.mask[..., None]
        return residual.reshape(*residual.shape[:-2], -1)

    def rows(self, keep: np.ndarray) -> Evidence:
        """The evidence of the windows at `keep`."""
        return Evidence(self.space, self.measured[keep], self.mask[keep], self.noise_sd, self.start_sd[keep])


@dataclass(frozen=True)
class Trial:
    """Simulations asked for: parameters (candidate, parameter), offsets of the starts (candidate, window, state)."""

    parameters: np.ndarray
    offsets: np.ndarray

    def __len__(self) -> int:
        return len(self.parameters)


@dataclass(frozen=True)
class Best:
    """The best point so far. offsets (window, state). error: RMSE over the noise floor (1: nothing left but noise)."""

    parameters: np.ndarray
    offsets: np.ndarray
    error: float


class Identifier(ABC):
    """Finds the parameters that `evidence` was made with.

    start: where to begin (parameter,), and offsets (window, state): with which offsets of the windows' starts (none
    where None). rounds: at most so many ask / tell. Trials stay inside the space's bounds.
    """

    def __init__(
        self,
        evidence: Evidence,
        *,
        start: np.ndarray,
        offsets: np.ndarray | None = None,
        seed: int = 0,
        rounds: int = 100,
        starts: int = 3,
    ):
        self.evidence = evidence
        self.space = evidence.space
        self.start = np.clip(start, self.space.low, self.space.high)
        self.offsets = np.zeros_like(evidence.start_sd) if offsets is None else offsets
        self.seed = seed
        self.rounds_left = rounds
        self.starts = starts

    @abstractmethod
    def ask(self) -> Trial:
        """The next simulations to run."""

    @abstractmethod
    def tell(self, outputs: np.ndarray, diverged: np.ndarray) -> None:
        """What they gave: outputs (candidate, window, step, output), diverged (candidate, window)."""

    @property
    @abstractmethod
    def best(self) -> Best:
        """The best point told so far."""

    @property
    @abstractmethod
    def done(self) -> bool:
        """Whether there is nothing more to ask."""


Evaluate = Callable[[Trial], tuple[np.ndarray, np.ndarray]]


def run(identifier: Identifier, evaluate: Evaluate, on_round: Callable[[Best], None] | None = None) -> Best:
    """Ask and tell until done; `on_round` sees the best after each."""
    while not identifier.done:
        trial = identifier.ask()
        identifier.tell(*evaluate(trial))
        identifier.rounds_left -= 1
        if on_round:
            on_round(identifier.best)
    return identifier.best
