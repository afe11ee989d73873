"""The scores of a round as a step of a diagnosis that is kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from typing import TYPE_CHECKING

from capture_cli.estimate.checkpoint import Values, made_or_taken
from capture_cli.select.candidates import Candidate, take, told

if TYPE_CHECKING:
    from capture_cli.select.search.forward_round import Scores


def kept_scores(method: Callable[..., None]) -> Callable[..., None]:
    """Makes a step of what scores the candidates of a round."""

    @wraps(method)
    def score_all(found: Scores, candidates: Sequence[Candidate]) -> None:
        def make() -> Values:
            method(found, candidates)
            return {f"{k}.{name}": v for k, c in enumerate(candidates) for name, v in told(c).items()}

        fits, current = found.models.fits, found.current
        if fits.checkpoint is None:
            method(found, candidates)
            return
        values = made_or_taken(fits, "score", current.effects, [current, *(c.name for c in candidates)], make)
        for number, candidate in enumerate(candidates):
            take(candidate, lambda name, number=number: values.get(f"{number}.{name}"))

    return score_all
