"""Sets of effects in the force balance: which models with one, two, three effects more predict it best?

Alone each of two effects may do worse than a third that stands in for both, so effects are not added one at a time: the
best models of each size are grown by one effect more (a beam). Of a law that a place lacks, all places may lack it: the
model that has it at each of its places is asked as one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from capture_cli.common.processes import in_processes
from capture_cli.estimate.balance.balanced_model import BalancedModel
from capture_cli.estimate.balance.screening import Addition, Screening
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.effects.placed import Placed, names_of


@dataclass(frozen=True)
class BeamSettings:
    """width: models of each size that are grown, of single effects such that differ; branches: effects that are added
    to each, of_a_branch: of those that do the same there. pairs: of two effects, that are asked whether either is good
    alone or not. of_a_kind: of a group of alike effects, and fitted: of larger models, that may be fitted.
    in_its_place: alike effects that are tried for each of the best model, beside its others. united:
    single effects that hold in simulations, which are put beside the best model there. sure: standard errors over
    blocks by which a model has to predict better than all smaller ones, to be fitted by simulation, and least: of log
    likelihood; one that is as good as the best may be so far behind it, or `near` of what that gains over smaller ones.
    """

    width: int = 4
    branches: int = 2
    of_a_branch: int = 2
    pairs: int = 8
    fitted: int = 8
    of_a_kind: int = 3
    in_its_place: int = 6
    united: int = 3
    sure: float = 2.0
    least: float = 3.0
    near: float = 0.2


SETTINGS = BeamSettings()


@dataclass(frozen=True)
class Level:
    """Models of one size. as_good: as the best one, which comes first, if that predicts better than without;
    others: those that predict surely worse. gain: of the best over smaller ones.
    """

    as_good: list[BalancedModel]
    others: list[BalancedModel]
    gain: float = 0.0

    @property
    def best(self) -> BalancedModel:
        return (self.as_good or self.others)[0]

    @classmethod
    def of(cls, models: Sequence[BalancedModel], gain: float, settings: BeamSettings) -> Level:
        """gain: of the first of the models over smaller ones."""
        best, least = models[0], max(settings.near * gain, settings.least)
        good = [m is best or not _is_better(best, m, least, settings.sure) for m in models]
        return cls(
            [m for m, own in zip(models, good, strict=True) if own],
            [m for m, own in zip(models, good, strict=True) if not own],
            gain,
        )

    def behind(self, settings: BeamSettings) -> Level | None:
        """Likewise of the others: the best of them, and what is as good; None where they predict no better than
        without.
        """
        if not (self.as_good and self.others):
            return None
        gain = self.gain + self.others[0].gain(self.best)[0]
        return Level.of(self.others, gain, settings) if gain > settings.least else None


def grown(
    screening: Screening,
    effects: Sequence[Placed],
    values: Sequence[np.ndarray],
    most: int,
    *,
    settings: BeamSettings = SETTINGS,
) -> Iterator[Level]:
    """Models with one addition more than `effects`, which have these `values`; then those with two, and so on to
    `most`, as long as the best of them predicts surely better than the best with fewer. They are worked out when they
    are asked for.

    An addition is an effect, or a law at all of its other places.
    """
    polished = [a for a in screening.additions(effects, values) if a.model.likelihood.size]
    groups = screening.groups(polished)
    if not groups:
        return
    best = polished[0]
    models = _best([a.model for a in _of_each_kind(groups, settings.of_a_kind)])
    if best.gain > max(settings.least, settings.sure * best.error):
        yield Level.of(models, best.gain, settings)
    else:
        yield Level([], models)
    alike = {a.placed.name: [o.model for o in g if o is not a] for g in groups for a in g}
    growing = [g[0].model for g in groups]
    for size in range(2, most + 1):
        growing = growing[: settings.width]
        more = _more(screening, growing, len(effects), settings)
        models = [m for found, _ in more for m in found]
        if size == 2:
            models += screening.fits.all_fitted(screening.pairs(effects, values, settings.pairs))
        models = _best(models)
        if not models:
            return
        for _, others in more:
            alike = others | alike
        models = _best([*models, *_with_others(screening, models[0], len(effects), alike, settings)])
        if not _is_better(models[0], growing[0], settings.least, settings.sure):
            return
        yield Level.of(models[: settings.fitted], models[0].gain(growing[0])[0], settings)
        growing = models


def _with_others(
    screening: Screening,
    model: BalancedModel,
    known: int,
    alike: Mapping[str, Sequence[BalancedModel]],
    settings: BeamSettings,
) -> list[BalancedModel]:
    """The model with one of its effects beyond the `known` replaced by such as do the same alone: beside others the
    difference may show. alike: by the name of an effect, models whose last one is such.
    """
    found = []
    for k, placed in enumerate(model.effects[known:], known):
        for other in alike.get(placed.name, ())[: settings.in_its_place]:
            if other.effects[-1] not in model.effects:
                effects, values = list(model.effects), list(model.values)
                effects[k], values[k] = other.effects[-1], other.values[-1]
                found.append(replace(model, effects=tuple(effects), values=tuple(values)))
    return screening.fits.all_fitted(found)


def _of_each_kind(groups: Sequence[Sequence[Addition]], count: int) -> list[Addition]:
    """Of each group of alike additions so many: the simplest, which may be all that is there, and the best. What is
    alike in the balance need not be in outputs that it does not use, or beside other effects.
    """
    found: list[Addition] = []
    for group in groups:
        ranked = [_simplest(group), *group]
        found += list({id(a): a for a in ranked}.values())[:count]
    return found


def _simplest(group: Sequence[Addition]) -> Addition:
    return min(group, key=lambda a: len(a.placed.effect.parameters))


# A model as names of its effects, and its numbers: what one process tells another
_Told = tuple[tuple[str, ...], dict[str, Any]]


def _more(
    screening: Screening, models: Sequence[BalancedModel], known: int, settings: BeamSettings
) -> list[tuple[list[BalancedModel], dict[str, list[BalancedModel]]]]:
    """Each model with one effect more, by the best that differ, and with the laws of those beyond the `known` at all of
    their other places; and of each of those effects the alike ones.
    """
    placed = {p.name: p for p in (*screening.placed, *(e for m in models for e in m.effects))}

    def more(model: BalancedModel) -> tuple[list[_Told], dict[str, list[_Told]]]:
        found, alike = _made(screening, model, known, settings)
        return [_told(m) for m in found], {name: [_told(m) for m in own] for name, own in alike.items()}

    def as_model(names: Sequence[str], numbers: dict[str, Any]) -> BalancedModel:
        return BalancedModel(tuple(placed[name] for name in names), **numbers)

    keys = [("more", m.key, known, settings.branches) for m in models]
    new = {key: m for m, key in zip(models, keys, strict=True) if not screening.knows(key)}
    made = in_processes(more, list(new.values()), screening.balance.threads)

    def taken() -> tuple[list[BalancedModel], dict[str, list[BalancedModel]]]:
        found, alike = next(made)
        others = {name: [as_model(*m) for m in own] for name, own in alike.items()}
        return [as_model(*m) for m in found], others

    return [screening.remembered(key, taken) for key in keys]


def _told(model: BalancedModel) -> _Told:
    return tuple(e.name for e in model.effects), model.numbers


def _made(
    screening: Screening, model: BalancedModel, known: int, settings: BeamSettings
) -> tuple[list[BalancedModel], dict[str, list[BalancedModel]]]:
    additions = screening.screened(model)
    groups = screening.groups(additions)[: settings.branches]
    chosen = _of_each_kind(groups, settings.of_a_branch)
    found = [a.model for a in chosen]
    for law in dict.fromkeys(e.law for e in model.effects[known:]):
        places = {e.effect.variant_of: None for e in model.effects if e.law == law}
        for addition in additions:
            effect = addition.placed.effect
            if addition.placed.law == law and effect.site != GLOBAL and addition.gain > 0:
                places.setdefault(effect.variant_of, addition.model)
        others = [m for m in places.values() if m is not None]
        if len(others) > 1:  # one alone is among the branches, if it is good
            found.append(_together(others, len(model.effects)))
    alike = {a.placed.name: [o.model for o in g if o is not a] for g in groups for a in g}
    return screening.fits.all_fitted(found), alike


def _together(models: Sequence[BalancedModel], known: int) -> BalancedModel:
    """The first of `models` with the effects beyond the `known` that the others add."""
    first, *others = models
    effects = (*first.effects, *(e for m in others for e in m.effects[known:]))
    values = (*first.values, *(v for m in others for v in m.values[known:]))
    return replace(first, effects=effects, values=values)


def _best(models: Sequence[BalancedModel]) -> list[BalancedModel]:
    """The models that differ in their effects, best first."""
    ranked = sorted((m for m in models if np.isfinite(m.likelihood).all()), key=lambda m: -m.likelihood.sum())
    distinct = {names_of(m.effects): m for m in reversed(ranked)}
    return sorted(distinct.values(), key=lambda m: -m.likelihood.sum())


def _is_better(model: BalancedModel, other: BalancedModel, least: float, sure: float) -> bool:
    """Whether it predicts better by more than `least`, and by so many standard errors."""
    gain, error = model.gain(other)
    return gain > max(least, sure * error)
