"""What goes again: minor effects that explain nothing after all, and those that nothing speaks for."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import takewhile

from capture_cli.estimate.fit import Fit
from capture_cli.estimate.noise.lack_of_fit import SETTINGS as LACK_OF_FIT
from capture_cli.select.model_comparison import SETTINGS as COMPARISON
from capture_cli.select.reason import Reason, Rejection
from capture_cli.select.search.answer import Accepted, Answer


def without_minor(answer: Answer, current: Fit) -> Fit:
    """`current` less the minor effects that came last, where they explain nothing after all."""
    minor = list(takewhile(lambda a: a.share < COMPARISON.minor, reversed(answer.accepted)))
    if answer.models.is_explained(current) or (len(minor) == 1 and current.error <= LACK_OF_FIT.near_floor):
        return current
    for accepted in minor:
        without = answer.models.without(current, accepted.name)
        if without is None:
            break
        answer.accepted.remove(accepted)
        answer.candidate(accepted.name).rejection = Rejection(Reason.MINOR, {"share": accepted.share})
        current = without
    return current


def backward(answer: Answer, current: Fit) -> Fit:
    """Drop the effects that nothing speaks for, given the others: as many at once, weakest first, as nothing speaks
    for together.
    """
    while True:
        idle = _idle(answer, current)
        if not idle:
            return current
        current = _dropped(answer, current, idle)


def _idle(answer: Answer, current: Fit) -> list[tuple[Accepted, Fit]]:
    """The effects that nothing speaks for, weakest first, each with the model without it."""
    idle = []
    for number, accepted in enumerate(answer.accepted):
        answer.step("drop", number, len(answer.accepted))
        fit = answer.models.without(current, accepted.name)
        if fit is None:
            continue
        if current.at.data.rough:  # with the effect a descent may have left a poor minimum
            fit = answer.models.better_from(fit, current) or fit
        accepted.support, _ = answer.support(fit, current, [accepted])
        if accepted.support.reason_against():
            idle.append((accepted, fit))
    return sorted(idle, key=lambda own: own[0].support.bic_gain)


def _dropped(answer: Answer, current: Fit, idle: Sequence[tuple[Accepted, Fit]]) -> Fit:
    """`current` without the weakest of `idle`: half as many each time that something speaks for them together, for
    of two that do the same each alone has nothing to do.
    """
    count, (_, left) = len(idle), idle[0]
    while count > 1:
        some = [accepted for accepted, _ in idle[:count]]
        answer.step("drop", 0, 1)
        without = answer.models.without(current, *(a.name for a in some))
        if without is not None and answer.support(without, current, some)[0].reason_against():
            left = without
            break
        count //= 2
    for accepted, _ in idle[:count]:
        answer.accepted.remove(accepted)
        answer.candidate(accepted.name).rejection = accepted.support.reason_against().with_others()
    return left
