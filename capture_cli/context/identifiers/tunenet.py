"""TuneNet (Allevato et al. 2020) with a transformer for its network, as the paper compares it (Section IV-B)."""

from __future__ import annotations

import numpy as np

from capture_cli.context.identifiers._learned import LearnedIdentifier
from capture_cli.context.identifiers.base import Rounds


class TuneNet(LearnedIdentifier):
    """Predicts the residual update from the current parameters to the target, from one round, again and again."""

    summary = "a transformer that predicts the change of the parameters, from one round at a time"
    fixed_window = 1
    residual = True

    @classmethod
    def examples(cls, rounds: Rounds) -> tuple[Rounds, np.ndarray]:
        """The first round alone, and the target: later rounds are not independent of it."""
        return rounds.first(1), rounds.target[:, None]
