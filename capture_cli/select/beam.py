"""Sets of effects in the force balance: which models with one, two, three effects more predict it best?

Alone each of two effects may do worse than a third that stands in for both, so effects are not added one at a time: the
best models of each size are grown by one effect more (a beam). Of a law that a place lacks, all places may lack it: the
model that has it at each of its places is asked as one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture_cli.effects.base import GLOBAL
from capture_cli.effects.placed import Placed
from capture_cli.select.screening import Addition, BalancedModel, Screening


@dataclass(frozen=True)
class BeamSettings:
    """width: models of each size that are grown; branches: effects that are added to each. different: groups of alike
    effects of which some are yielded at a time, of_a_kind: of each. united: single effects that
    hold in simulations, which are put beside the best model there. sure: standard errors over
    blocks by which a larger model has to predict better than all smaller ones, and least: of log likelihood.
    """

    width: int = 8
    branches: int = 2
    different: int = 4
    of_a_kind: int = 3
    united: int = 3
    sure: float = 2.0
    least: float = 3.0


SETTINGS = BeamSettings()


def grown(
    screening: Screening,
    effects: Sequence[Placed],
    values: Sequence[np.ndarray],
    most: int,
    *,
    settings: BeamSettings = SETTINGS,
) -> Iterator[list[BalancedModel]]:
    """Models with one addition more than `effects`, which have these `values`, some at a time, best first; then those
    with two, and so on to `most`, as long as the best of them predicts surely better than the best with fewer. They are
    worked out when they are asked for.

    An addition is an effect, or a law at all of its other places.
    """
    polished = [a for a in screening.additions(effects, values) if a.model.likelihood.size]
    groups = screening.groups(polished)
    for first in range(0, min(len(groups), settings.width), settings.different):
        yield _best(_of_each_kind(groups[first : first + settings.different], settings), settings.width)
    growing = _best([a.model for a in polished], settings.width)
    for _ in range(most - 1):
        if not growing:
            return
        more = [m for model in growing for m in _more(screening, model, len(effects), settings)]
        level = _best(more, settings.width)
        if not level or not _is_surely_better(level[0], growing[0], settings):
            return
        yield level
        growing = level


def _of_each_kind(groups: Sequence[Sequence[Addition]], settings: BeamSettings) -> list[BalancedModel]:
    """Of each group of alike additions some: the simplest, which may be all that is there, and the best. What is alike
    in the balance need not be in outputs that it does not use.
    """
    found: list[Addition] = []
    for group in groups:
        ranked = [_simplest(group), *group]
        found += list({id(a): a for a in ranked}.values())[: settings.of_a_kind]
    return [a.model for a in found]


def _simplest(group: Sequence[Addition]) -> Addition:
    return min(group, key=lambda a: len(a.placed.effect.parameters))


def _more(
    screening: Screening, model: BalancedModel, known: int, settings: BeamSettings
) -> list[BalancedModel]:
    """The model with one effect more, by the best that differ, and with the laws of those beyond the `known` at all of
    their other places.
    """
    additions = screening.screened(model)
    found = [_simplest(g).model for g in screening.groups(additions)[: settings.branches]]
    for kind in dict.fromkeys(e.kind for e in model.effects[known:]):
        places = {e.effect.variant_of: None for e in model.effects if e.kind == kind}
        for addition in additions:
            effect = addition.placed.effect
            if addition.placed.kind == kind and effect.site != GLOBAL and addition.gain > 0:
                places.setdefault(effect.variant_of, addition.model)
        others = [m for m in places.values() if m is not None]
        if len(others) > 1:  # one alone is among the branches, if it is good
            found.append(_together(others, len(model.effects)))
    return [screening.fitted(m) for m in found]


def _together(models: Sequence[BalancedModel], known: int) -> BalancedModel:
    """The first of `models` with the effects beyond the `known` that the others add."""
    first, *others = models
    effects = (*first.effects, *(e for m in others for e in m.effects[known:]))
    values = (*first.values, *(v for m in others for v in m.values[known:]))
    return replace(first, effects=effects, values=values)


def _best(models: Sequence[BalancedModel], count: int) -> list[BalancedModel]:
    """The best `count` of the models that differ in their effects."""
    ranked = sorted((m for m in models if np.isfinite(m.likelihood).all()), key=lambda m: -m.likelihood.sum())
    distinct = {frozenset(e.name for e in m.effects): m for m in reversed(ranked)}
    return sorted(distinct.values(), key=lambda m: -m.likelihood.sum())[:count]


def _is_surely_better(model: BalancedModel, other: BalancedModel, settings: BeamSettings) -> bool:
    gain, error = model.gain(other)
    return gain > max(settings.least, settings.sure * error)
