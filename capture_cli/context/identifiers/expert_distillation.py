"""Expert distillation (paper, Section IV-B; Laskin et al. 2022): from the source to the target in one iteration."""

from __future__ import annotations

import numpy as np

from capture_cli.context.identifiers._learned import LearnedIdentifier
from capture_cli.context.identifiers.base import Rounds


class ExpertDistillation(LearnedIdentifier):
    """The paper's model, trained on one-iteration adaptation: one round under the source, then the target.

    It learns no history, so each new round is all that it reads.
    """

    summary = "the same transformer, trained to jump from a random source to the target in one round"
    fixed_window = 1

    @classmethod
    def examples(cls, rounds: Rounds) -> tuple[Rounds, np.ndarray]:
        """The first round alone, and the target: later rounds are not independent of it."""
        return rounds.first(1), rounds.target[:, None]
