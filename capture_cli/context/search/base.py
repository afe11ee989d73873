"""What a search strategy is: the parameters of each round, from the source to the target (paper, Section III-C)."""

from abc import ABC, abstractmethod

import numpy as np


class Search(ABC):
    """Walks from a source to a target that it knows, as an identifier that does not know it should.

    alpha: shape of the symmetric Beta that a strategy draws from, which takes another; None where it draws from none.
    """

    summary: str
    alpha: float | None = None

    def walk(
        self, source: np.ndarray, target: np.ndarray, low: np.ndarray, high: np.ndarray, uniform: np.ndarray
    ) -> np.ndarray:
        """Parameters (pair, round, parameter): first the source, last the target.

        source, target (pair, parameter), inside low, high (parameter,). uniform (pair, round - 1, parameter): draws
        from [0, 1), all the randomness there is.
        """
        path = self.path(source, target, low, high, uniform)
        path[:, -1] = target
        return path

    @abstractmethod
    def path(self, source, target, low, high, uniform) -> np.ndarray:
        """As `walk`, before the last round is set to the target."""
