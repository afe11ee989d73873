"""The scores of a round as a step of a diagnosis that is kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import wraps
from typing import TYPE_CHECKING, Any

from capture_cli.estimate.checkpoint import Values, made_or_taken, what_is_there
from capture_cli.select.candidates import Candidate
from capture_cli.select.score import Score

if TYPE_CHECKING:
    from capture_cli.select.forward_round import Scores

# of a candidate, and of its score, what a round says
SCORED = ("start", "start_elsewhere", "start_doubted", "shapes_tried", "why_rejected")
SCORE = tuple(f.name for f in fields(Score))


def kept_scores(method: Callable[..., None]) -> Callable[..., None]:
    """Makes a step of what scores the candidates of a round."""

    @wraps(method)
    def score_all(found: Scores, candidates: Sequence[Candidate]) -> None:
        def make() -> Values:
            method(found, candidates)
            every = ({**what_is_there(c, SCORED), **what_is_there(c.score, SCORE)} for c in candidates)
            return {f"{k}.{name}": v for k, values in enumerate(every) for name, v in values.items()}

        fits, current = found.models.fits, found.current
        if fits.checkpoint is None:
            method(found, candidates)
            return
        values = made_or_taken(fits, "score", current.effects, [current, *(c.name for c in candidates)], make)
        for number, candidate in enumerate(candidates):
            _take_score(candidate, lambda name, number=number: values.get(f"{number}.{name}"))

    return score_all


def _take_score(candidate: Candidate, value: Callable[[str], Any]) -> None:
    for name in SCORED:
        setattr(candidate, name, value(name))
    candidate.fit = candidate.select = candidate.support = None
    candidate.score = None if value("gain") is None else Score(*map(value, SCORE))
