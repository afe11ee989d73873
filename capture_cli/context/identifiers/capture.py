"""CAPTURE (paper, Section III-D): distils the search that the histories show, by predicting its next parameters."""

from __future__ import annotations

import numpy as np

from capture_cli.context.identifiers._learned import LearnedIdentifier
from capture_cli.context.identifiers.base import Rounds


class Capture(LearnedIdentifier):
    """Reads the last rounds of a history and proposes the next parameters, as the search would have chosen them.

    The search that is distilled is that of the histories: randomised binary in the paper, linear interpolation and
    plain binary in its ablations.
    """

    summary = "the paper's transformer: the next parameters of the search, from the last rounds"

    @classmethod
    def examples(cls, rounds: Rounds) -> tuple[Rounds, np.ndarray]:
        """After each round its successor's parameters; after the last, which is at the target, the target."""
        return rounds, np.concatenate([rounds.parameters[:, 1:], rounds.target[:, None]], axis=1)
