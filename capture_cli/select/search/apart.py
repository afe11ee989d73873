"""A law that is at all of its places at once, split: at each of them on its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from capture_cli.estimate.fit import Fit
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.effects.placed import Placed
from capture_cli.select.reason import Reason, Rejection
from capture_cli.select.search.answer import Accepted, Answer
from capture_cli.select.search.rivals import Rivals


def split(rivals: Rivals, current: Fit, newest: Sequence[Accepted]) -> Fit:
    """`current` with each of the `newest` effects that is at all places at once at each of them on its own, where that
    is clearly better, also than another effect in its place: filtered sensors look like controls that each come late.
    """
    answer, models = rivals.answer, rivals.models
    for accepted in newest:
        places = _places(answer, accepted)
        if len(places) < 2:
            continue
        answer.step("refit", 0, 1)
        fit = models.fit(*_apart(current, accepted, places), current)
        if fit is None or not models.is_better(current, fit):
            continue
        everywhere = answer.candidate(accepted.name)
        rivals.ask_of(current, accepted)
        current = rivals.compare(current, [accepted])
        if accepted.name != everywhere.name and not models.is_better(current, fit):
            continue
        current = fit
        everywhere.rejection = Rejection(Reason.BETTER_APART)
        _replace(answer, accepted, places)
    return current


def _places(answer: Answer, accepted: Accepted) -> list[Placed]:
    """Of an effect that is at all places at once each of them, as far as it is a candidate: at a sensor that is not in
    the log it would show nothing.
    """
    if accepted.placed.effect.site != GLOBAL:
        return []
    same = [c.placed for c in answer.outside if c.placed.law == accepted.placed.law]
    return [p for p in same if p.effect.site != GLOBAL]


def _apart(current: Fit, accepted: Accepted, places: Sequence[Placed]) -> tuple[list[Placed], np.ndarray]:
    """The effects of `current` with one at each of `places` for the accepted one, and where a fit of them begins."""
    own = current.columns(accepted.name)
    rest = [e for e in current.effects if e.name != accepted.name]
    start = np.concatenate([np.delete(current.point, own), np.tile(current.point[own], len(places))])
    return [*rest, *places], start


def _replace(answer: Answer, accepted: Accepted, places: Sequence[Placed]) -> None:
    """Accept an effect at each of `places` for the one at all of them."""
    answer.accepted.remove(accepted)
    share = accepted.share / len(places)
    for place in places:
        candidate = answer.candidate(place.name)
        candidate.rejection = None
        answer.accepted.append(replace(accepted, placed=place, score=candidate.score, rivals=[], share=share))
