"""What a search strategy is: the parameters of each round, from the source to the target (paper, Section III-C)."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    alpha: float = 5.0  # shape of the symmetric Beta; 5 keeps samples off the bracket's ends


class Search(ABC):
    """Walks from a source to a target that it knows, as an identifier that does not know it should.

    alpha: shape of the symmetric Beta(alpha, alpha) that a strategy with `takes_alpha` draws from.
    """

    summary: str
    takes_alpha = False

    def __init__(self, alpha: float = SETTINGS.alpha):
        self.alpha = alpha

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
