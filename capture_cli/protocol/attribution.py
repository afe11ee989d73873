"""Which effect? Score every candidate at every site, refit the best, accept what holds; forward, then backward."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product, takewhile

import numpy as np

from capture_cli.diagnosis.acceptance import TINY, Support, bic_gain
from capture_cli.diagnosis.folds import Folds
from capture_cli.diagnosis.lack_of_fit import NEAR_FLOOR
from capture_cli.diagnosis.score import Score
from capture_cli.effects.base import GLOBAL
from capture_cli.effects.placed import Placed
from capture_cli.errors import OutOfTime
from capture_cli.protocol.balance_scores import score_in_balance
from capture_cli.protocol.candidates import Candidate, all_candidates, worth_a_refit
from capture_cli.protocol.fit import Fit, least
from capture_cli.protocol.forward_round import RIVALS, ForwardRound, Scores, by_score
from capture_cli.protocol.model_comparison import (
    CLEARLY_BETTER,
    TIED,
    WORSE,
    ModelComparison,
    effective_samples,
)
from capture_cli.protocol.model_fits import ModelFits
from capture_cli.protocol.part_fit import PartFit
from capture_cli.protocol.plausibility import at_end, implausible

MOST_EFFECTS = 6
# Of what the declared model leaves above the noise floor: one that takes less is minor. A model that is wrong in a way
# that no effect is takes any number of minor ones, so they stand only where with them nothing is left, or one alone
# comes near the floor.
MINOR, MOST_MINOR = 0.05, 2
# Of the squared error above the noise floor: what an effect's other places must take together
MOST_OF_IT = 0.5
AS_MUCH = 0.8  # of an effect's score, with the others in: what has more may be what is there in its place
PAIRED = 3  # rivals of each of two effects that are exchanged at once
ALSO_ENOUGH = "; but with it, too, no more is left than chance allows"  # of a rival that is not as good
STEPS_AS_WELL = "{mine} does as well, and so do steps of this length"


@dataclass
class Accepted:
    """An effect in the model, candidates that did as well when it entered, and how it stands in the last model.

    score: when it entered, and so are those of the rivals: later, with it in the model, they answer to what it leaves.
    share: of the squared error above the noise floor of the declared model, what it took when it entered.
    along: whether it came with another of its kind, at another place. together: where it was
    found at all of its places at once, what was found, and rivals of that; one list for all of the places.
    """

    placed: Placed
    score: Score | None
    rivals: list[Candidate]
    support: Support
    share: float
    along: bool = False
    together: list[Candidate] = field(default_factory=list)
    tied: list[Candidate] = field(default_factory=list)

    @property
    def tied_with(self) -> list[str]:
        return [c.name for c in self.tied]

    @property
    def name(self) -> str:
        return self.placed.name


class Attribution:
    """Forward selection with a backward step.

    folds: what is fitted, and what judges; nothing judges where the log is one window long. is_explained: whether a
    model leaves nothing but noise. most_effects: to add; what comes along with another is not counted. candidates: the
    whole catalogue where None. spreads: whether what was found at one place is tried at all the others at once, which
    terms of an expression are not. on_step is told what is being tried, the number of it, of how many, and what was
    found so far; where it raises OutOfTime, the search ends with the last model that was whole.

    out_of_time: whether it ended so.
    """

    def __init__(
        self,
        fits: ModelFits,
        folds: Folds,
        *,
        seed: int,
        is_explained: Callable[[Fit], bool],
        most_effects: int = MOST_EFFECTS,
        candidates: Sequence[Candidate] | None = None,
        spreads: bool = True,
        on_step: Callable[[str, int, int, Sequence[str]], None] = lambda *_: None,
    ):
        self.models = ModelComparison(fits, folds, seed=seed, is_explained=is_explained)
        self.most_effects = most_effects
        self.spreads = spreads
        self.on_step = on_step
        self.candidates = all_candidates(fits.prepared) if candidates is None else list(candidates)
        self.models.candidates = self.candidates if candidates is None else []
        self.ranked: list[Candidate] = []  # what the last round's scores speak for, best first
        self.accepted: list[Accepted] = []
        self.excess = TINY  # squared error above the noise floor of the declared model
        self.out_of_time = False

    def run(self, declared: Fit) -> Fit:
        """Add effects to the declared model until none is accepted or nothing is left; returns the last model."""
        self._keep(declared)
        try:
            return self._search(declared)
        except OutOfTime:
            self.out_of_time = True
            last, self.accepted = self._whole
            inside = {a.name for a in self.accepted}
            for candidate in self.candidates:
                if candidate.name not in inside and candidate.why_rejected is None:
                    candidate.why_rejected = "not decided: the time was over"
            return last

    def _keep(self, current: Fit) -> Fit:
        """Take note of a model that is whole, and the effects in it."""
        self._whole = current, [replace(a, tied=list(a.tied)) for a in self.accepted]
        return current

    def _search(self, declared: Fit) -> Fit:
        current = declared
        self.models.know(declared)
        while self._count < self.most_effects and not self.models.is_explained(current):
            known = len(self.accepted)
            if not known:
                self.excess = max(current.excess, TINY)
            found = self._forward(current)
            if not known and (found is None or not self.models.is_explained(found.fit)):
                two = self._two_at_once(current, found)
                if two is not None:
                    current = self._keep(two)
                    continue
            if found is None:
                break
            better = self.models.better_from(current, found.fit)
            if better is not None:
                withdrawn = self._candidate(self.accepted.pop().name)
                withdrawn.why_rejected = "without it, fitted again from where it led, the model does as well"
                current = better
                continue
            current = self._at_other_places(self._at_each_place(found.fit))
            current = self._keep(self._backward(current, self.accepted[:known], Support.reason_against_entry))
            if len(self._minor) >= MOST_MINOR and not self.models.is_explained(current):
                break
        current = self._without_minor(current)
        current = self._keep(self._backward(current, self.accepted, Support.reason_against))
        current = self._keep(self._in_pairs(self._one_for_two(current)))
        self._ask_again(current)
        current = self._keep(self._compare_with_rivals(current))
        together = self._at_all_places(current)
        return current if together is current else self._compare_with_rivals(together)

    @property
    def _count(self) -> int:
        return sum(not a.along for a in self.accepted)

    @property
    def _minor(self) -> list[Accepted]:
        """The last of the accepted effects, as far as they are minor."""
        return list(takewhile(lambda a: a.share < MINOR, reversed(self.accepted)))

    def _without_minor(self, current: Fit) -> Fit:
        """`current` less the minor effects that came last, where they explain nothing after all."""
        minor = self._minor
        if self.models.is_explained(current) or (len(minor) == 1 and current.error <= NEAR_FLOOR):
            return current
        for accepted in minor:
            without = self.models.without(current, accepted.name)
            if without is None:
                break
            self.accepted.remove(accepted)
            self._candidate(accepted.name).why_rejected = (
                f"it takes {accepted.share:.1%} of what the declared model left above the noise floor, and with it "
                "something is left all the same: a correction of a model that is wrong otherwise"
            )
            current = without
        return current

    def _at_each_place(self, current: Fit) -> Fit:
        """The newest effect at each of its places on its own, where it was accepted at all of them together, and that
        is clearly better.
        """
        name, together = current.effects[-1]
        if together.site != GLOBAL:
            return current
        # those among the candidates: at a sensor that is not in the log it would show nothing
        places = [
            c.placed for c in self.candidates if c.placed.kind == name and c.placed.effect.site != GLOBAL
        ]
        if len(places) < 2:
            return current
        size = len(together.parameters)
        rest, own = current.point[: len(current.point) - size], current.point[len(current.point) - size :]
        start = np.concatenate([rest, np.tile(own, len(places))])
        fit = self.models.fit([*current.effects[:-1], *places], start, current)
        if fit is None:
            return current
        joint = self.accepted[-1]
        # another kind at all places may do what this one takes other values for at each: a delay, where this is a lag
        together = [self._candidate(joint.name), *joint.rivals]
        together = [replace(c) for c in together if c.placed.effect.site == GLOBAL]
        if self._gain(least([current, *(c.fit for c in together)]), fit) < CLEARLY_BETTER:
            return current
        self.accepted.pop()
        self._candidate(joint.name).why_rejected = "better at each of its places on its own"
        for place in places:
            self._candidate(place.name).why_rejected = None
        self.accepted += [
            Accepted(
                place,
                self._candidate(place.name).score,
                self._rivals_at(place.effect.site, joint),
                joint.support,
                joint.share,
                along=k > 0,
                together=together,
            )
            for k, place in enumerate(places)
        ]
        return fit

    def _at_all_places(self, current: Fit) -> Fit:
        """One effect at all places in exchange for those at each of them, where these are no longer clearly better.

        While something else is missing, a delay of all sensors may be followed better by another lag of each.
        """
        groups = {id(a.together): a.together for a in self.accepted if a.together}
        for together in groups.values():
            parts = [a for a in self.accepted if a.together is together]
            found = self._in_place_of(parts, together, current) if len(parts) > 1 else None
            if found is not None and self._gain(found.fit, current) < CLEARLY_BETTER:
                current = self._exchange(
                    parts, found, together, f"{found.name} does as much at all places at once"
                )
        return current

    def _one_for_two(self, current: Fit) -> Fit:
        """One rival of two effects that do for each other's job in the place of both, where they are no better.

        An IMU that is askew may be an attitude's error first, and then one of all its sensors.
        """
        for pair in combinations(self.accepted, 2):
            if not _are_kin(*pair) or any(a not in self.accepted for a in pair):
                continue
            rivals = list({r.name: r for a in pair for r in a.rivals}.values())
            found = self._in_place_of(pair, rivals, current)
            if found is not None and self._gain(found.fit, current) <= 0:
                current = self._exchange(pair, found, rivals, f"{found.name} alone does as much as both")
        return current

    def _exchange(
        self, parts: Sequence[Accepted], found: Candidate, rivals: Sequence[Candidate], why: str
    ) -> Fit:
        """Accept `found` in the place of `parts`, with `rivals`; the model that stands then."""
        for part in parts:
            self._candidate(part.name).why_rejected = why
            self.accepted.remove(part)
        self._candidate(found.name).why_rejected = None
        inside = {found.name, *(a.name for a in self.accepted)}
        others = [r for r in rivals if r.name not in inside]
        share = sum(p.share for p in parts if not p.along)
        self.accepted.append(Accepted(found.placed, found.score, others, parts[0].support, share))
        return self._backward(found.fit, self.accepted, Support.reason_against)

    def _in_place_of(
        self, parts: Sequence[Accepted], candidates: Sequence[Candidate], current: Fit
    ) -> Candidate | None:
        """The one of `candidates` that explains most in the place of the accepted effects `parts`, with its fit."""
        inside = {a.name for a in self.accepted}
        found = []
        for candidate in (c for c in candidates if c.name not in inside):
            self._step("compare", 0, 1)
            fit = self._exchanged(current, parts, [candidate])
            if fit is not None and not at_end(fit, candidate.placed):
                found.append(replace(candidate, fit=fit))
        return min(found, key=lambda c: c.fit.penalised_squares, default=None)

    @staticmethod
    def _gain(before: Fit, after: Fit) -> float:
        """What the model `after` gains over `before` by BIC."""
        added = len(after.point) - len(before.point)
        return bic_gain(before.penalised_squares, after.penalised_squares, effective_samples(after), added)

    def _at_other_places(self, current: Fit) -> Fit:
        """The newest effect at its other places, too, all at once, where that takes most of what is left: of friction
        that a model lacks, it lacks that of every joint.
        """
        newest = self.accepted[-1]
        if not self.spreads or self.models.is_explained(current):
            return current
        kin = self._kin(newest, current)
        if not kin:
            return current
        self._step("refit", 0, 1)
        effects = [*current.effects, *(c.placed for c in kin)]
        fit = self.models.fit(effects, np.concatenate([current.point, *(c.start for c in kin)]), current)
        if fit is None or any(implausible(self.models, current, fit, c.placed) for c in kin):
            return current
        taken = current.excess - fit.excess
        if taken < MOST_OF_IT * current.excess:
            return current
        for candidate in kin:
            accepted = Accepted(
                candidate.placed,
                candidate.score,
                self._rivals_at(candidate.placed.effect.site, newest),
                newest.support,
                taken / self.excess,
                along=True,
            )
            self.accepted.append(accepted)
            candidate.why_rejected = None
        return self._backward(fit, self.accepted[-len(kin) :], Support.reason_against)

    def _kin(self, newest: Accepted, current: Fit) -> list[Candidate]:
        """The newest effect at its other places, as far as scores speak for it; one of each place."""
        inside = {a.name for a in self.accepted}
        taken = {newest.placed.effect.variant_of}
        kin = []
        ranked = self.ranked
        if self.models.screening(self._step) is not None:  # with it in the model, which takes no simulation
            same = [
                c for c in self.candidates if c.placed.kind == newest.placed.kind and c.name not in inside
            ]
            ranked = [c for c in self._scored(current, same) if c.is_sure]
        for candidate in ranked:
            effect = candidate.placed.effect
            is_kin = candidate.placed.kind == newest.placed.kind and candidate.name not in inside
            if is_kin and GLOBAL not in (effect.site, newest.placed.effect.site):
                if effect.variant_of not in taken:
                    kin.append(candidate)
                taken.add(effect.variant_of)
        return kin

    def _rivals_at(self, site: str, accepted: Accepted) -> list[Candidate]:
        """Candidates at `site` of the kinds that are rivals of `accepted` where it was found."""
        kinds = {r.placed.kind for r in accepted.rivals}
        own = [c for c in self.ranked if c.placed.effect.site == site and c.placed.kind in kinds]
        return [replace(c) for c in own[:RIVALS]]

    def _step(self, what: str, number: int, total: int) -> None:
        self.on_step(what, number, total, [a.name for a in self.accepted])

    def _forward(self, current: Fit) -> Candidate | None:
        """The effect that is accepted next, with its fit; None where none is."""
        inside = {a.name for a in self.accepted}
        found = ForwardRound(
            self.models,
            current,
            [c for c in self.candidates if c.name not in inside],
            patient=not self.accepted,
            on_step=self._step,
        )
        self.ranked, choice = found.ranked, found.choose()
        if choice is None:
            return None
        chosen, rivals = choice
        share = (current.excess - chosen.fit.excess) / self.excess
        self.accepted.append(Accepted(chosen.placed, chosen.score, rivals, chosen.support, share))
        return chosen

    def _two_at_once(self, current: Fit, one: Candidate | None) -> Fit | None:
        """Two effects that together explain what `one`, the best by itself, does not: in place of it.

        Alone each of them may do worse than a third that stands in for both.
        """
        screening = self.models.screening(self._step)
        if screening is None or self.most_effects < 2:
            return None
        self._step("balance", 0, 1)
        model = screening.pair(
            current.effects, [current.point[current.columns(e.name)] for e in current.effects]
        )
        if model is None:
            return None
        added = model.effects[len(current.effects) :]
        self._step("refit", 0, 1)
        fit = self.models.fit(model.effects, model.start, current)
        if fit is None or not self.models.is_explained(fit):
            return None
        if any(implausible(self.models, current, fit, placed) for placed in added):
            return None
        if one is not None:
            self._candidate(
                self.accepted.pop().name
            ).why_rejected = f"{' and '.join(e.name for e in added)} together explain more"
        before, share = self.models.judge(current), (current.excess - fit.excess) / self.excess / len(added)
        for placed in added:
            support, _ = self._support(current, fit, placed, before, len(self.candidates))
            self._candidate(placed.name).why_rejected = None
            self.accepted.append(Accepted(placed, None, [], support, share))
        return self._backward(fit, list(self.accepted), Support.reason_against_entry)

    # --- backward ---

    def _backward(self, current: Fit, judged: Sequence[Accepted], reason: Callable) -> Fit:
        """Drop, weakest first, the effects among `judged` that there is a `reason` against, given the others."""
        judged = list(judged)
        while judged:
            weakest, without = None, None
            for accepted in judged:
                self._step("drop", 0, 1)
                fit = self.models.without(current, accepted.name)
                if fit is None:
                    continue
                before = self.models.judge(fit)
                tried = len(self.candidates)
                accepted.support, _ = self._support(fit, current, accepted.placed, before, tried)
                if reason(accepted.support) and (
                    weakest is None or accepted.support.bic_gain < weakest.support.bic_gain
                ):
                    weakest, without = accepted, fit
            if weakest is None:
                return current
            judged.remove(weakest)
            self.accepted.remove(weakest)
            self._candidate(
                weakest.name
            ).why_rejected = f"with the other effects in: {reason(weakest.support)}"
            current = without
        return current

    def _support(
        self, without: Fit, fit: Fit, placed: Placed, before: PartFit | None, tried: int
    ) -> tuple[Support, PartFit | None]:
        """The support for `placed` in `fit` over the model `without` it, and how `fit` does on what judges.

        before: how that model does there. tried: of how many candidates the effect is the best.
        """
        hypotheses = tried * self._candidate(placed.name).shapes_tried
        return self.models.support(without, fit, placed, before, hypotheses)

    def _candidate(self, name: str) -> Candidate:
        return next(c for c in self.candidates if c.name == name)

    # --- ties ---

    def _in_pairs(self, current: Fit) -> Fit:
        """Two accepted effects at once in exchange for rivals of theirs, where that is clearly better.

        A second-order lag of a control and a low-pass of what it moves may stand for a lag and a delay, so that neither
        of these is better in the place of one. Of effects that do not do the same job this need not be asked.
        """
        best, exchanged = current, ()
        for pair in (p for p in combinations(self.accepted, 2) if _are_kin(*p)):
            for rivals in product(*(self._no_larger(accepted) for accepted in pair)):
                names = {r.name for r in rivals}
                if len(names) < len(rivals) or names & {a.name for a in self.accepted}:
                    continue
                self._step("compare", 0, 1)
                fit = self._exchanged(current, pair, rivals)
                if fit is None or any(at_end(fit, r.placed) for r in rivals):
                    continue
                if self.models.is_better(best, fit):
                    best, exchanged = fit, tuple(zip(pair, rivals, strict=True))
        for accepted, rival in exchanged:
            why = f"{rival.name} explains more, with others in the model"
            self._candidate(accepted.name).why_rejected = why
            self._candidate(rival.name).why_rejected = None
            accepted.rivals = [
                Candidate(accepted.placed, accepted.score, self._values(current, accepted)),
                *(r for r in accepted.rivals if r is not rival),
            ]
            accepted.placed, accepted.score = rival.placed, rival.score
        return self._backward(best, self.accepted, Support.reason_against) if exchanged else current

    @staticmethod
    def _values(fit: Fit, accepted: Accepted) -> np.ndarray:
        """Values of the accepted effect's parameters in `fit`, (parameter,)."""
        return fit.point[fit.columns(accepted.name)]

    @staticmethod
    def _no_larger(accepted: Accepted) -> list[Candidate]:
        """Its first rivals that have no more parameters than it."""
        size = len(accepted.placed.effect.parameters)
        return [r for r in accepted.rivals if len(r.placed.effect.parameters) <= size][:PAIRED]

    def _ask_again(self, current: Fit) -> None:
        """Rivals of accepted effects, by what the model without it leaves with the others in; but of the last, unless
        it came with another at once.

        The first was found while the others were missing: what spoke for it then may have been theirs.
        """
        later = [number for number, accepted in enumerate(self.accepted) if not accepted.along]
        first = self.accepted[: max(later, default=0)]
        for accepted in [*first, *(a for a in self.accepted[len(first) :] if a.score is None)]:
            without = self.models.without(current, accepted.name)
            if without is None:
                continue
            inside = {a.name for a in self.accepted} - {accepted.name}
            candidates = [replace(c) for c in self.candidates if c.name not in inside]
            ranked = self._scored(without, candidates)
            mine = next((c for c in ranked if c.name == accepted.name), None)
            if mine is None:
                continue
            known = {r.name for r in accepted.rivals}
            new = [c for c in ranked if c.score.gain > AS_MUCH * mine.score.gain and c.name not in known]
            new, _ = worth_a_refit([c for c in new if c is not mine])
            accepted.score = mine.score
            accepted.rivals = [*(c for c in ranked if c.name in known), *new[:RIVALS]]

    def _scored(self, current: Fit, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Those of the candidates that their scores speak for in `current`, best first."""
        screening = self.models.screening(self._step)
        if screening is None:
            Scores(self.models, current, self._step).score(candidates)
            return by_score(candidates)
        candidates = [c for c in candidates if c.name in screening.covered]
        score_in_balance(screening, current, candidates)
        return by_score(candidates)

    def _exchanged(self, current: Fit, some: Sequence[Accepted], rivals: Sequence[Candidate]) -> Fit | None:
        """The model with `rivals` in the place of `some` accepted effects."""
        out = np.concatenate([np.arange(len(current.point))[current.columns(a.name)] for a in some])
        rest = [e for e in current.effects if e.name not in {a.name for a in some}]
        start = np.concatenate([np.delete(current.point, out), *(r.start for r in rivals)])
        return self.models.fit([*rest, *(r.placed for r in rivals)], start, current, current)

    def _compare_with_rivals(self, current: Fit) -> Fit:
        """Put each accepted effect's rivals in its place: swap where one is better, tie where none can tell."""
        for accepted in list(self.accepted):
            inside = {a.name for a in self.accepted}
            accepted.tied, others = [], []
            for number, rival in enumerate(r for r in accepted.rivals if r.name not in inside):
                self._step("compare", number, len(accepted.rivals))
                other = self._swapped(current, accepted, rival)
                if other is not None:
                    others.append(other)
            best, others = self.models.best(self._candidate_of(current, accepted), others)
            for other in others:
                verdict = self.models.compare(best, other)
                if verdict == TIED and _are_steps(best.placed, other.placed):
                    verdict = STEPS_AS_WELL
                enough = verdict == WORSE and self.models.is_explained(other.fit)
                self._candidate(other.name).why_rejected = (
                    verdict.format(mine=best.name) + ALSO_ENOUGH * enough
                )
                if verdict == TIED:
                    accepted.tied.append(other)
            if best.name != accepted.name:
                self._candidate(best.name).why_rejected = None
                accepted.placed, accepted.score, accepted.support = best.placed, best.score, best.support
                current = best.fit
        return current

    def _candidate_of(self, fit: Fit, accepted: Accepted) -> Candidate:
        select = self.models.judge(fit)
        return Candidate(accepted.placed, accepted.score, None, fit, select, accepted.support)

    def _swapped(self, current: Fit, accepted: Accepted, rival: Candidate) -> Candidate | None:
        """The model with `rival` in the place of `accepted`, if the rival is supported there."""
        without = self.models.without(current, accepted.name)
        if without is None:
            return None
        rest = without.effects
        fit = self.models.fit(
            [*rest, rival.placed], np.concatenate([without.point, rival.start]), without, current
        )
        if fit is None:
            return None
        before = self.models.judge(without)
        support, select = self._support(without, fit, rival.placed, before, len(self.candidates))
        found = Candidate(rival.placed, rival.score, rival.start, fit, select, support)
        if support.reason_against() or implausible(self.models, without, fit, found.placed):
            return None
        return found


def _are_steps(one: Placed, other: Placed) -> bool:
    """Whether they are the model's motion in shorter steps of two lengths: no experiment would tell them apart."""
    return one.kind == other.kind and one.effect.substeps > 1 and not one.effect.parameters


def _are_kin(one: Accepted, other: Accepted) -> bool:
    """Whether one did for the other's job as well, or another candidate for both of theirs."""
    names, others = ({a.name, *(r.name for r in a.rivals)} for a in (one, other))
    return bool(names & others)
