"""What an identifier is: it asks for simulations, is told what they gave, and says what is best so far."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from capture_cli.estimate.solve.linearization import Data, Linearization, Trial


@dataclass(frozen=True)
class Best:
    """The best point so far. corrections (window, state). error: RMSE over the noise floor (1: nothing left but
    noise).
    """

    parameters: np.ndarray
    corrections: np.ndarray
    error: float


class AskTell(ABC):
    """What every identifier is: it asks, is told, and knows its best.

    There are two kinds: an `Identifier` fits the windows of a whole log; a `RoundIdentifier` proposes
    parameters round by round, one measured rollout at a time, for many pairs at once. summary: one line for the docs.
    needs_checkpoint: whether it is made by `capture train-sysid`. likelihood: whether it was trained by the Gaussian
    likelihood. extra: of the installation, that asking and telling need; None where the core is enough. settable: those
    of its numbers that an evaluation may set.
    """

    summary: str
    extra: str | None = None
    settable: tuple[str, ...] = ()
    needs_checkpoint = False
    likelihood = False

    @property
    @abstractmethod
    def best(self):
        """The best so far."""


class Identifier(AskTell):
    """Finds the parameters that `data` was made with.

    start: where to begin (parameter,), and corrections (window, state): with which corrections of the windows' initial
    states (none where None). rounds: at most so many ask / tell. Trials stay inside the space's bounds.
    """

    def __init__(
        self,
        data: Data,
        *,
        start: np.ndarray,
        corrections: np.ndarray | None = None,
        seed: int = 0,
        rounds: int = 100,
        starts: int = 3,
    ):
        self.data = data
        self.space = data.space
        self.start = np.clip(start, self.space.low, self.space.high)
        self.corrections = np.zeros_like(data.initial_sd) if corrections is None else corrections
        self.seed = seed
        self.rounds_left = rounds
        self.starts = starts

    def carried_on(self, data: Data, rounds: int) -> Self | None:
        """The same search on other data about the same parameters, with what it knows of where to look.

        None where nothing of it is of use but its best, where a new one begins.
        """
        return None

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
    def at(self) -> Linearization | None:
        """The linearization at the best, measured there or updated, if what was told says it."""
        return None

    @property
    @abstractmethod
    def at_rest(self) -> bool:
        """Whether more rounds would gain nothing."""

    @property
    def done(self) -> bool:
        """Whether there is nothing more to ask."""
        return self.rounds_left <= 0 or self.at_rest


# outputs, which diverged, and, where not everything is simulated, whether all was
Evaluate = Callable[[Trial], tuple]


def run(identifier: Identifier, evaluate: Evaluate, on_round: Callable[[Best], None] | None = None) -> Best:
    """Ask and tell until done; `on_round` sees the best after each."""
    while not identifier.done:
        trial = identifier.ask()
        identifier.tell(*evaluate(trial))
        identifier.rounds_left -= 1
        if on_round:
            on_round(identifier.best)
    return identifier.best
