"""Which effect? Score every candidate at every site, refit the best, accept what holds; forward, then backward."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product, takewhile

import numpy as np

from capture_cli.diagnosis.acceptance import TINY, Support, bic_gain
from capture_cli.diagnosis.folds import Folds
from capture_cli.diagnosis.lack_of_fit import NEAR_FLOOR
from capture_cli.diagnosis.score import Score, similarity
from capture_cli.effects.base import GLOBAL
from capture_cli.effects.placed import Placed
from capture_cli.identifiers.intervals import intervals
from capture_cli.protocol.candidates import (
    Candidate,
    all_candidates,
    score_at_null,
    thinned,
    worth_a_refit,
)
from capture_cli.protocol.model_comparison import (
    CLEARLY_BETTER,
    TIED,
    WORSE,
    ModelComparison,
    effective_samples,
)
from capture_cli.protocol.model_fits import Fit, ModelFits, PartFit, least
from capture_cli.protocol.narrow_shapes import NarrowShapes

MOST_EFFECTS = 6
# Of the squared error above the noise floor: an effect that takes less away corrects a model that is wrong otherwise
MATERIAL = 0.1
# Of what the declared model leaves above the noise floor: one that takes less is minor. A model that is wrong in a way
# that no effect is takes any number of minor ones, so they stand only where with them nothing is left, or one alone
# comes near the floor.
MINOR, MOST_MINOR = 0.05, 2
# Of a range. A result file says "at its bound" from AT_BOUND on; but a descent gives up where its trust region is this
# small, and an effect that ends so near to where its range does is drawn there.
NEAR_BOUND = 1e-3
MOST_OF_IT = (
    0.5  # of the squared error above the noise floor: what an effect's other places must take together
)
PAIRED = 3  # rivals of each of two effects that are exchanged at once
RIVALS = 4  # other candidates that an accepted effect is compared with once everything else is in the model
# Before it is said that nothing explains the log, the next best are fitted, as often as there are pairs here: those of
# this share of the best score, which have to take this share of what is above the noise floor. Where contacts make the
# error rough, and where a declared parameter has to make way, a score at null says little; but what begins with next to
# none of it is believed only where it explains nearly all.
FURTHER = (0.2, MATERIAL), (0.2, MATERIAL), (0.1, 0.9)
ALSO_ENOUGH = "; but with it, too, no more is left than chance allows"  # of a rival that is not as good
SIMILAR = 0.97  # cosine of responses beyond which a candidate that was not fitted may still be a rival


@dataclass
class Accepted:
    """An effect in the model, candidates that did as well when it entered, and how it stands in the last model.

    score: when it entered, and so are those of the rivals: later, with it in the model, they answer to what it leaves.
    share: of the squared error above the noise floor of the declared model, what it took when it entered.
    along: whether it came with another of its kind, at another place.
    """

    placed: Placed
    score: Score | None
    rivals: list[Candidate]
    support: Support
    share: float
    along: bool = False
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
    whole catalogue where None. on_step is told what is being tried, the number of it, of how many, and what was found
    so far.
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
        on_step: Callable[[str, int, int, Sequence[str]], None] = lambda *_: None,
    ):
        self.models = ModelComparison(fits, folds, seed=seed, is_explained=is_explained)
        self.most_effects = most_effects
        self.on_step = on_step
        self.candidates = all_candidates(fits.prepared) if candidates is None else list(candidates)
        self.ranked: list[Candidate] = []  # what the last round's scores speak for, best first
        self.accepted: list[Accepted] = []
        self.excess = TINY  # squared error above the noise floor of the declared model

    def run(self, declared: Fit) -> Fit:
        """Add effects to the declared model until none is accepted or nothing is left; returns the last model."""
        current = declared
        self.models.know(declared)
        while self._count < self.most_effects and not self.models.is_explained(current):
            known = len(self.accepted)
            if not known:
                self.excess = max(current.error**2 - 1, TINY)
            found = self._forward(current)
            if found is None:
                break
            better = self.models.better_from(current, found.fit)
            if better is not None:
                withdrawn = self._candidate(self.accepted.pop().name)
                withdrawn.why_rejected = "without it, fitted again from where it led, the model does as well"
                current = better
                continue
            current = self._at_other_places(self._at_each_place(found.fit))
            current = self._backward(current, self.accepted[:known], Support.reason_against_entry)
            if len(self._minor) >= MOST_MINOR and not self.models.is_explained(current):
                break
        current = self._without_minor(current)
        current = self._backward(current, self.accepted, Support.reason_against)
        return self._compare_with_rivals(self._in_pairs(current))

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
        added = size * (len(places) - 1)
        gain = bic_gain(current.squares, fit.squares, effective_samples(fit), added)
        if gain < CLEARLY_BETTER:
            return current
        joint = self.accepted.pop()
        self._candidate(joint.name).why_rejected = "better at each of its places on its own"
        for place in places:
            self._candidate(place.name).why_rejected = None
        self.accepted += [
            Accepted(place, self._candidate(place.name).score, [], joint.support, joint.share, along=k > 0)
            for k, place in enumerate(places)
        ]
        return fit

    def _at_other_places(self, current: Fit) -> Fit:
        """The newest effect at its other places, too, all at once, where that takes most of what is left: of friction
        that a model lacks, it lacks that of every joint.
        """
        newest = self.accepted[-1]
        if self.models.is_explained(current):
            return current
        kin = self._kin(newest)
        if not kin:
            return current
        self._step("refit", 0, 1)
        effects = [*current.effects, *(c.placed for c in kin)]
        fit = self.models.fit(effects, np.concatenate([current.point, *(c.start for c in kin)]), current)
        if fit is None or any(self._implausible(current, fit, c) for c in kin):
            return current
        taken = current.error**2 - fit.error**2
        if taken < MOST_OF_IT * (current.error**2 - 1):
            return current
        rivals = {r.placed.kind for r in newest.rivals}
        for candidate in kin:
            site = candidate.placed.effect.site
            own = [c for c in self.ranked if c.placed.effect.site == site and c.placed.kind in rivals]
            accepted = Accepted(
                candidate.placed,
                candidate.score,
                [replace(c) for c in own[:RIVALS]],
                newest.support,
                taken / self.excess,
                along=True,
            )
            self.accepted.append(accepted)
            candidate.why_rejected = None
        return self._backward(fit, self.accepted[-len(kin) :], Support.reason_against)

    def _kin(self, newest: Accepted) -> list[Candidate]:
        """The newest effect at its other places, as far as the last round's scores speak for it; one of each place."""
        inside = {a.name for a in self.accepted}
        taken = {newest.placed.effect.variant_of}
        kin = []
        for candidate in self.ranked:
            effect = candidate.placed.effect
            is_kin = candidate.placed.kind == newest.placed.kind and candidate.name not in inside
            if is_kin and GLOBAL not in (effect.site, newest.placed.effect.site):
                if effect.variant_of not in taken:
                    kin.append(candidate)
                taken.add(effect.variant_of)
        return kin

    def _step(self, what: str, number: int, total: int) -> None:
        self.on_step(what, number, total, [a.name for a in self.accepted])

    # --- forward ---

    def _forward(self, current: Fit) -> Candidate | None:
        inside = {a.name for a in self.accepted}
        tried = [c for c in self.candidates if c.name not in inside]
        part, at = thinned(self.models.fit_part, current)
        narrow = NarrowShapes(self.models.fits, part, replace(current, at=at))
        for number, candidate in enumerate(tried):
            self._step("score", number, len(tried))
            score_at_null(narrow, candidate)
        ranked = sorted((c for c in tried if c.why_rejected is None), key=lambda c: -c.score.gain)
        self.ranked = ranked
        refitted, others = worth_a_refit(ranked)
        supported = self._refit_all(current, refitted, len(tried))
        for worth, material in FURTHER:
            if supported or self.accepted or not others:
                break
            least_gain = worth * ranked[0].score.gain
            refitted, left = worth_a_refit([c for c in others if c.score.gain > least_gain])
            others = [*left, *(c for c in others if c.score.gain <= least_gain)]
            supported = self._refit_all(current, refitted, len(tried), material)
        for candidate in others:
            candidate.why_rejected = (
                f"explains less at first sight ({candidate.score.gain:.3g} of {ranked[0].score.gain:.3g})"
            )
        if not supported:
            return None
        return self._choose(current, supported, others)

    def _refit_all(
        self, current: Fit, candidates: Sequence[Candidate], tried: int, material: float = MATERIAL
    ) -> list[Candidate]:
        """Fit the model with each of the candidates in it; those that are supported, and take `material`."""
        before, best = self.models.judge(current), None
        # fits with hidden states take long: they come last, and are given up where they stay far behind
        for number, candidate in enumerate(sorted(candidates, key=lambda c: len(c.placed.effect.states))):
            self._step("refit", number, len(candidates))
            self._refit(current, candidate, before, tried, best)
            best = least([best, candidate.fit])
            if candidate.why_rejected is None:
                candidate.why_rejected = _slight(current, candidate.fit, material)
        return [c for c in candidates if c.why_rejected is None]

    def _refit(
        self, current: Fit, candidate: Candidate, before: PartFit | None, tried: int, rival: Fit | None
    ) -> None:
        """Fit the model with the candidate in it, and judge; given up where it stays far behind `rival`."""
        declared = self._nudged(current, candidate)
        starts = [s for s in (candidate.start, candidate.start_elsewhere) if s is not None]
        starts = [np.concatenate([declared, s]) for s in starts]
        effects = [*current.effects, candidate.placed]
        fit = self.models.fit(effects, starts[0], current, rival, starts[1:])
        if candidate.start_doubted is not None and (fit is None or not self.models.is_explained(fit)):
            start = np.concatenate([declared, candidate.start_doubted])
            fit = self.models.explained_from(start, effects, current) or fit
        if fit is None or fit.squares >= current.squares:
            far = fit is not None and not fit.finished
            candidate.why_rejected = (
                f"fitted jointly it stays far behind {rival.effects[-1].name}"
                if far
                else "fitted jointly it explains nothing more"
            )
            return
        candidate.fit = fit
        candidate.support, candidate.select = self._support(current, fit, candidate.placed, before, tried)
        reason = candidate.support.reason_against_entry()
        candidate.why_rejected = reason or self._implausible(current, fit, candidate)

    @staticmethod
    def _nudged(current: Fit, candidate: Candidate) -> np.ndarray:
        """The current parameters, moved along with the effect's linear step."""
        return current.space.from_unit(current.at.x + candidate.score.parameters)

    def _implausible(self, current: Fit, fit: Fit, candidate: Candidate) -> str | None:
        """Evidence against an effect that leaves something: at a bound, or driving a declared parameter to one.

        Where nothing is left, that is where they are, but for what is vague at a bound. A declared parameter may fall
        to zero: then it had been standing in for the effect. Nor does it count where the log hardly determines it: then
        it may be anywhere.
        """
        effect, at_end = candidate.placed.effect, _at_end(fit, candidate.placed)
        vague = next((at_end[name] for name in effect.vague_at_end if name in at_end), None)
        if vague or self.models.is_explained(fit):
            return vague
        doubt = effect.doubt(fit.point[fit.columns(candidate.name)], self.models.fits.prepared.log.longest)
        if doubt or at_end:
            return doubt or next(iter(at_end.values()))
        x = fit.space.to_unit(fit.point)
        size = len(current.point)
        was = current.at.x
        determined = intervals(fit.at).identifiable
        for i in range(size):
            at_bound = min(x[i], 1 - x[i]) < NEAR_BOUND <= min(was[i], 1 - was[i])
            bound = fit.space.low[i] if x[i] < 0.5 else fit.space.high[i]
            if determined[i] and bound != 0 and at_bound:
                return f"it drives {fit.space.names[i]} to its bound ({fit.point[i]:.3g})"
        return None

    def _choose(self, current: Fit, supported: list[Candidate], unfitted: list[Candidate]) -> Candidate:
        """The best of the candidates that are supported; among those it cannot be told from, the simplest, and then
        the one that fits best.

        The others are its rivals, and so are those not fitted whose response is nearly its own.
        """
        ranked = self._by_loss(supported)
        best = ranked[0]
        as_good = [c for c in supported if c is best or self.models.as_good(best, c)]
        chosen = min(as_good, key=lambda c: (len(c.placed.effect.parameters), c.fit.squares))
        rivals = [c for c in ranked if c is not chosen]
        for candidate in rivals:
            candidate.why_rejected = f"{chosen.name} explains as much with less, or more"
        similar = [c for c in unfitted if abs(similarity(chosen.score.response, c.score.response)) > SIMILAR]
        share = (current.error**2 - chosen.fit.error**2) / self.excess
        rivals = [replace(c) for c in (*rivals[:RIVALS], *similar[:RIVALS])]
        self.accepted.append(Accepted(chosen.placed, chosen.score, rivals, chosen.support, share))
        return chosen

    def _by_loss(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """The best first, by what judges."""
        order = np.argsort(self.models.losses(candidates), kind="stable")
        return [candidates[i] for i in order]

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
        """As of `ModelComparison`; tried: of how many candidates the effect is the best."""
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
                if fit is None or any(_at_end(fit, r.placed) for r in rivals):
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
        """Those of the accepted effect's parameters in `fit`, (parameter,)."""
        return fit.point[fit.columns(accepted.name)]

    @staticmethod
    def _no_larger(accepted: Accepted) -> list[Candidate]:
        """Its first rivals that have no more parameters than it."""
        size = len(accepted.placed.effect.parameters)
        return [r for r in accepted.rivals if len(r.placed.effect.parameters) <= size][:PAIRED]

    def _exchanged(self, current: Fit, pair: Sequence[Accepted], rivals: Sequence[Candidate]) -> Fit | None:
        """The model with `rivals` in the place of the accepted effects `pair`."""
        out = np.concatenate([np.arange(len(current.point))[current.columns(a.name)] for a in pair])
        rest = [e for e in current.effects if e.name not in {a.name for a in pair}]
        start = np.concatenate([np.delete(current.point, out), *(r.start for r in rivals)])
        return self.models.fit([*rest, *(r.placed for r in rivals)], start, current, current)

    def _compare_with_rivals(self, current: Fit) -> Fit:
        """Put each accepted effect's rivals in its place: swap where one is better, tie where none can tell."""
        for accepted in list(self.accepted):
            inside = {a.name for a in self.accepted}
            others = []
            for number, rival in enumerate(r for r in accepted.rivals if r.name not in inside):
                self._step("compare", number, len(accepted.rivals))
                other = self._swapped(current, accepted, rival)
                if other is not None:
                    others.append(other)
            best, others = self.models.best(self._candidate_of(current, accepted), others)
            for other in others:
                verdict = self.models.compare(best, other)
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
        if support.reason_against() or self._implausible(without, fit, found):
            return None
        return found


def _are_kin(one: Accepted, other: Accepted) -> bool:
    """Whether one did for the other's job as well, or another candidate for both of theirs."""
    names, others = ({a.name, *(r.name for r in a.rivals)} for a in (one, other))
    return bool(names & others)


def _at_end(fit: Fit, placed: Placed) -> dict[str, str]:
    """Parameters of an effect in `fit` that are at the end of their range, other than at null, and how to say so."""
    effect, own = placed.effect, fit.columns(placed.name)
    x, space, found = fit.space.to_unit(fit.point), fit.space, {}
    for i, name in zip(range(own.start, own.stop), effect.space.names, strict=True):
        null = (space.nominal[i] - space.low[i]) / space.span[i]
        if min(x[i], 1 - x[i]) < NEAR_BOUND and abs(x[i] - null) > NEAR_BOUND and name not in effect.shares:
            found[name] = (
                f"it would have to be at the end of its range ({space.names[i]} = {fit.point[i]:.3g})"
            )
    return found


def _slight(current: Fit, fit: Fit, material: float) -> str | None:
    """Why `fit`, which has to take this share, is no explanation of what `current` leaves above the noise, or None."""
    excess = current.error**2 - 1
    taken = current.error**2 - fit.error**2
    if taken >= material * excess:
        return None
    return f"it takes {taken / excess:.1%} of what is above the noise floor: that is no explanation of it"
