"""Why an effect is not in the answer: a code, and the names and numbers that say how far. Reports make the sentence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np


class Reason(StrEnum):
    """What speaks against an effect; behind each the facts of a `Rejection` with it.

    best, rival, place: names of effects; parameter: EFFECT.PARAMETER, or one of the task; errors: over the noise floor.
    """

    # of its score
    DIVERGED = "diverged"
    MOVES_NOTHING = "moves-nothing"
    NO_COLUMN = "no-column"  # in the force balance it moves nothing, or with the wrong sign
    IMITATED = "imitated"
    NO_SCORE = "no-score"  # score
    PREDICTS_NO_BETTER = "predicts-no-better"  # gain, standard_error
    BEHIND_AT_FIRST_SIGHT = "behind-at-first-sight"  # score, most
    PROMISED_LITTLE = "promised-little"
    NOT_ASKED = "not-asked"
    # of a fit with it
    AT_END = "at-end"  # parameter, value
    NOT_BELIEVED = "not-believed"  # text: what its law says of its values
    DRIVES_TO_BOUND = "drives-to-bound"  # parameter, value
    PROMISES_TOO_LITTLE = "promises-too-little"  # promised, left: errors
    FAR_BEHIND = "far-behind"  # rival
    NO_GAIN = "no-gain"
    SLIGHT = "slight"  # share: of what is above the noise floor
    LITTLE_WAS_LEFT = "little-was-left"  # before, after: errors
    MINOR = "minor"  # share: likewise, of what the declared model left
    LEAVES_SOMETHING = "leaves-something"  # after: error
    COARSER_DOES_NOT_HOLD = "coarser-does-not-hold"  # rival
    # of tests
    NOT_FROM_ZERO = "not-from-zero"  # p
    NOT_WORTH_PARAMETERS = "not-worth-parameters"  # bic: by how much it rises
    NOT_BETTER_HELD_OUT = "not-better-held-out"  # p
    # of another in its place
    LESS_DOES_IT = "less-does-it"  # best
    DOES_NOT_HOLD = "does-not-hold"  # place
    TIED = "tied"  # best
    STEPS_AS_WELL = "steps-as-well"  # best
    EXPLAINS_LESS = "explains-less"  # best
    EXPLAINS_ENOUGH = "explains-enough"  # best: it explains more, but this one leaves no more than chance
    MORE_PARAMETERS = "more-parameters"  # best
    BEATEN = "beaten"  # best: behind a third that is behind it, though it is not behind that itself
    BETTER_APART = "better-apart"
    OUT_OF_TIME = "out-of-time"


@dataclass(frozen=True)
class Rejection:
    """beside_others: whether that was said with the other effects in the model, after it had been accepted."""

    reason: Reason
    facts: Mapping[str, float | str] = field(default_factory=dict)
    beside_others: bool = False

    def with_others(self) -> Rejection:
        """The same, said of an effect beside others."""
        return replace(self, beside_others=True)

    def document(self) -> dict[str, Any]:
        """As JSON, which has no number that is not finite: None in its place."""
        facts = {k: v if isinstance(v, str) or np.isfinite(v) else None for k, v in self.facts.items()}
        return {"reason": str(self.reason), "facts": facts, "beside_others": self.beside_others}

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> Rejection:
        """What `document` gave."""
        found = cls(**document)
        return replace(found, reason=Reason(found.reason))
