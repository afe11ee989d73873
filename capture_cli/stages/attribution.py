"""Which effect? Score every candidate at every site, refit the best, accept what holds; forward, then backward."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from capture_cli.diagnosis.acceptance import (
    BLOCK_TIMES,
    TINY,
    Support,
    bic_gain,
    correlation_steps,
    paired_p_value,
    ratio_p_value,
)
from capture_cli.diagnosis.score import STEP, Score, score, similarity
from capture_cli.diagnosis.split import Folds
from capture_cli.effects import REGISTRY
from capture_cli.effects._periodic_force import PeriodicForce
from capture_cli.effects.base import GLOBAL, Effect
from capture_cli.identifiers.intervals import intervals
from capture_cli.simulator import placed_name
from capture_cli.stages.model_fits import Fit, ModelFits, PartFit, Placed
from capture_cli.stages.narrow_shapes import NarrowShapes
from capture_cli.stages.prepared_log import PreparedLog

# Best-scoring candidates that are fitted jointly, each time round: so many that differ, with so many like each, no more
# than so many in all. A force of one direction can be a bias, a preload or a tilt: they must not keep all others out.
DIFFERENT, OF_A_KIND, REFITTED = 5, 3, 8
ALIKE = 0.99  # cosine of responses beyond which candidates are of a kind
# Of an amplitude's range: a slope near null, and a secant further out to either side. Friction and stops act one way.
PROBES = (0.01, 0.1, -0.1)
# Where none of those moves anything: what acts from a threshold on only, a limit that the controls never come near
FAR_PROBES = (0.5, -0.5, 0.8, -0.8, 0.9, -0.9, 0.95, -0.95)
SHAPES, SHAPES_OF_SEVERAL = 5, 3  # values tried of an effect's one shape, or of each of several
SCORED_WINDOWS = 40  # evenly spread: a score needs no more
# Of the objective, over the variance that would be left: less is no reason to fit. The best of n shapes has 2 log(n)
# more by chance.
SMALLEST_GAIN = 12.0
ABSORBED = 0.02  # share of a sensitivity that must be left once the declared parameters have imitated it
MOST_EFFECTS = 6
# Of the squared error above the noise floor: an effect that takes less away corrects a model that is wrong otherwise
MATERIAL = 0.1
INDISTINCT = 0.05  # two models are tied where the paired test between them is not below this
AT_BOUND = 1e-3  # of an amplitude's range
RIVALS = 4  # other candidates that an accepted effect is compared with once everything else is in the model
AGAIN_ROUNDS = 20  # in which a model without an effect is to get where it got with it
CLEARLY_BETTER = 10.0  # of BIC: "very strong" (Kass & Raftery 1995)
BARE_MENTION = 2.0  # of BIC: less is "not worth more than a bare mention", however steadily it comes
BETTER, TIED = "better", "tied with {mine}: this log cannot tell them apart"
WORSE, NOT_WORTH_IT = "{mine} explains more", "no better than {mine}, with more parameters"
SIMILAR = 0.97  # cosine of responses beyond which a candidate that was not fitted may still be a rival
SAME_RESPONSE = 0.9999  # cosine of two effects' responses beyond which no parameter value tells them apart


@dataclass
class Candidate:
    """An effect at a site, and what became of it in the last round that it was tried in.

    start: where a refit begins; start_elsewhere: at another peak, of an effect that repeats.
    """

    effect: Placed
    score: Score | None = None
    start: np.ndarray | None = None
    fit: Fit | None = None
    select: PartFit | None = None
    support: Support | None = None
    why_rejected: str | None = None
    shapes_tried: int = 1
    start_elsewhere: np.ndarray | None = None

    @property
    def name(self) -> str:
        return placed_name(*self.effect)


@dataclass
class Accepted:
    """An effect in the model, candidates that did as well when it entered, and how it stands in the last model."""

    effect: Placed
    rivals: list[Candidate]
    support: Support
    tied: list[Candidate] = field(default_factory=list)

    @property
    def tied_with(self) -> list[str]:
        return [c.name for c in self.tied]

    @property
    def name(self) -> str:
        return placed_name(*self.effect)


def all_candidates(model: mujoco.MjModel) -> list[Candidate]:
    """Every effect at every site of the model."""
    return [
        Candidate((name, cls(model, site))) for name, cls in REGISTRY.items() for site in cls.sites(model)
    ]


def as_driven(prepared: PreparedLog) -> mujoco.MjModel:
    """The model with actuators that take what the log gives them, and no more: ranges of effects follow from it."""
    model = copy(prepared.task.model)
    for channel, inputs in zip(prepared.task.inputs, prepared.log.inputs.T, strict=True):
        peak = float(np.abs(inputs).max())
        if model.actuator_ctrllimited[channel.index]:
            peak = min(peak, float(np.abs(model.actuator_ctrlrange[channel.index]).max()))
        if peak > 0:
            model.actuator_ctrllimited[channel.index] = True
            model.actuator_ctrlrange[channel.index] = -peak, peak
    return model


class Attribution:
    """Forward selection with a backward step.

    folds: what is fitted, and what judges; nothing judges where the log is one window long. is_explained: whether a
    model leaves nothing but noise. candidates: the whole catalogue where None. on_step is told what is being
    tried, the number of it, of how many, and what was found so far.
    """

    def __init__(
        self,
        fits: ModelFits,
        folds: Folds,
        *,
        seed: int,
        is_explained: Callable[[Fit], bool],
        candidates: Sequence[Candidate] | None = None,
        on_step: Callable[[str, int, int, Sequence[str]], None] = lambda *_: None,
    ):
        self.fits = fits
        self.folds = folds
        self.fit_part = fits.prepared.part(folds.fit)
        self.seed = seed
        self.is_explained = is_explained
        self.on_step = on_step
        self.candidates = list(candidates or all_candidates(as_driven(fits.prepared)))
        self.accepted: list[Accepted] = []
        self.stages: list[tuple[str, Fit]] = []
        self._fitted: dict[frozenset[str], Fit | None] = {}
        self._judged: dict[Fit, PartFit] = {}

    def run(self, declared: Fit) -> Fit:
        """Add effects to the declared model until none is accepted or nothing is left; returns the last model."""
        current = declared
        self.stages = [("declared", declared)]
        self._fitted[_key(declared.effects)] = declared
        while len(self.accepted) < MOST_EFFECTS and not self.is_explained(current):
            known = len(self.accepted)
            found = self._forward(current)
            if found is None:
                break
            better = self._better_without(current, found.fit)
            if better is not None:
                self.accepted.pop()
                current, self.stages[-1] = better, (self.stages[-1][0], better)
                continue
            current = found.fit
            self.stages.append((f"+ {found.name}", current))
            current = self._at_each_place(current)
            current = self._backward(current, self.accepted[:known], Support.reason_against_entry)
        current = self._backward(current, self.accepted, Support.reason_against)
        return self._compare_with_rivals(current)

    def _better_without(self, current: Fit, found: Fit) -> Fit | None:
        """A better fit of the `current` model, begun where `found` ended, which has one effect more.

        Where contacts make the error rough, an effect may be no more than the way out of a poor minimum.
        """
        again = self.fits.fit(
            self.fit_part,
            current.effects,
            found.point[: len(current.point)],
            offsets=found.offsets,
            rounds=AGAIN_ROUNDS,
            seed=self.seed,
        )
        if again is None:
            return None
        gain = bic_gain(current.squares, again.squares, self._effective_samples(again), 0)
        if gain < CLEARLY_BETTER:
            return None
        self._fitted[_key(current.effects)] = again
        return again

    def _at_each_place(self, current: Fit) -> Fit:
        """The newest effect at each of its places on its own, where it was accepted at all of them together, and that
        is clearly better.
        """
        name, together = current.effects[-1]
        if together.site != GLOBAL:
            return current
        sites = [s for s in together.sites(together.model) if s != GLOBAL]
        if len(sites) < 2 or len(self.accepted) - 1 + len(sites) > MOST_EFFECTS:
            return current
        places = [(name, type(together)(together.model, site)) for site in sites]
        size = len(together.parameters)
        rest, own = current.point[: len(current.point) - size], current.point[len(current.point) - size :]
        start = np.concatenate([rest, np.tile(own, len(places))])
        fit = self._fit([*current.effects[:-1], *places], start, current.offsets)
        if fit is None:
            return current
        added = size * (len(places) - 1)
        gain = bic_gain(current.squares, fit.squares, self._effective_samples(fit), added)
        if gain < CLEARLY_BETTER:
            return current
        joint = self.accepted.pop()
        self._candidate(joint.name).why_rejected = "better at each of its places on its own"
        self.accepted += [Accepted(place, [], joint.support) for place in places]
        self.stages.append((f"{name} at each place", fit))
        return fit

    def _step(self, what: str, number: int, total: int) -> None:
        self.on_step(what, number, total, [a.name for a in self.accepted])

    # --- forward ---

    def _forward(self, current: Fit) -> Candidate | None:
        inside = {a.name for a in self.accepted}
        tried = [c for c in self.candidates if c.name not in inside]
        part, at = _thinned(self.fit_part, current)
        narrow = NarrowShapes(self.fits, part, replace(current, at=at))
        for number, candidate in enumerate(tried):
            self._step("score", number, len(tried))
            self._score(narrow, candidate)
        ranked = sorted((c for c in tried if c.why_rejected is None), key=lambda c: -c.score.gain)
        refitted, others = _worth_a_refit(ranked)
        for candidate in others:
            candidate.why_rejected = (
                f"explains less at first sight ({candidate.score.gain:.3g} of {ranked[0].score.gain:.3g})"
            )
        before, best = self.judge(current), None
        for number, candidate in enumerate(refitted):
            self._step("refit", number, len(refitted))
            self._refit(current, candidate, before, len(tried), best)
            best = _least([best, candidate.fit])
        supported = [c for c in refitted if c.why_rejected is None]
        if not supported:
            return None
        return self._choose(supported, others)

    def _score(self, narrow: NarrowShapes, candidate: Candidate) -> None:
        """Fill in the candidate's score and where a refit should start, or why it is out."""
        candidate.fit = candidate.select = candidate.support = candidate.score = None
        candidate.why_rejected = candidate.start_elsewhere = None
        shapes, candidate.shapes_tried = _shapes(narrow, candidate.effect[1])
        scored, moves = self._scores(narrow, candidate, shapes, PROBES)
        if not moves:
            scored, moves = self._scores(narrow, candidate, shapes, FAR_PROBES)
        if scored:
            candidate.score, candidate.start = scored[0]
            candidate.start_elsewhere = _at_another_peak(candidate.effect[1], [s for _, s in scored])
        if candidate.score is None:
            candidate.why_rejected = "every simulation with it diverged"
        elif not moves:
            candidate.why_rejected = "it moves no output of this log"
        elif candidate.score.unabsorbed < ABSORBED:
            candidate.why_rejected = (
                "parameters that are in the model imitate it: this log cannot tell it from them"
            )
        elif candidate.score.gain < SMALLEST_GAIN + 2 * np.log(candidate.shapes_tried):
            candidate.why_rejected = f"it explains nothing (score {candidate.score.gain:.2g})"

    def _scores(
        self, narrow: NarrowShapes, candidate: Candidate, shapes: np.ndarray, shares: Sequence[float]
    ) -> tuple[list[tuple[Score, np.ndarray]], bool]:
        """Scores and where a refit should start from each, best first; and whether any probe moves an output.

        shapes (point, parameter): with null amplitudes. shares: of the amplitudes' ranges, at which each is probed.
        """
        effect, at = candidate.effect[1], narrow.fit.at
        space = effect.space
        amplitudes = [i for i, n in enumerate(space.names) if n not in effect.shapes]
        probes, steps = _probes(effect, amplitudes, shapes, shares)
        residuals, diverged = self.fits.probe(narrow.part, narrow.fit, candidate.effect, probes)
        change = at.residual - residuals  # what the probe adds to the outputs
        if amplitudes:
            low = (space.low - space.nominal)[amplitudes] / space.span[amplitudes]
            high = (space.high - space.nominal)[amplitudes] / space.span[amplitudes]
        else:
            low, high = np.zeros(1), steps
        size = len(low)
        scored = []
        for first in range(0, len(probes), size):
            block = slice(first, first + size)
            if diverged[block].any():
                continue
            sensitivity = np.moveaxis(change[block] / steps[block][:, None, None], 0, -1)
            found = score(at, sensitivity, low, high)
            start = probes[first].copy()
            far = shares is FAR_PROBES and found.amplitudes @ steps[block] > 0
            begin = steps[block] if far else found.amplitudes  # below its threshold an effect has no slope
            if amplitudes:
                start[amplitudes] = space.nominal[amplitudes] + begin * space.span[amplitudes]
            scored.append((found, np.clip(start, space.low, space.high)))
        return sorted(scored, key=lambda s: -s[0].gain), bool(np.any(change[~diverged]))

    def _refit(
        self, current: Fit, candidate: Candidate, before: PartFit | None, tried: int, rival: Fit | None
    ) -> None:
        """Fit the model with the candidate in it, and judge; given up where it stays far behind `rival`."""
        declared = self._nudged(current, candidate)
        starts = [s for s in (candidate.start, candidate.start_elsewhere) if s is not None]
        starts = [np.concatenate([declared, s]) for s in starts]
        fit = self._fit([*current.effects, candidate.effect], starts[0], current.offsets, rival, starts[1:])
        if fit is None or fit.squares >= current.squares:
            far = fit is not None and not fit.finished
            candidate.why_rejected = (
                f"fitted jointly it stays far behind {placed_name(*rival.effects[-1])}"
                if far
                else "fitted jointly it explains nothing more"
            )
            return
        candidate.fit = fit
        candidate.support, candidate.select = self._support(current, fit, candidate.effect, before, tried)
        reason = candidate.support.reason_against_entry()
        candidate.why_rejected = reason or self._implausible(current, fit, candidate) or _slight(current, fit)

    @staticmethod
    def _nudged(current: Fit, candidate: Candidate) -> np.ndarray:
        """The current parameters, moved along with the effect's linear step."""
        return current.space.from_unit(current.at.x + candidate.score.parameters)

    def _fit(
        self,
        effects: Sequence[Placed],
        start: np.ndarray,
        offsets: np.ndarray,
        rival: Fit | None = None,
        elsewhere: Sequence[np.ndarray] = (),
    ) -> Fit | None:
        """The fit of the declared model with `effects`: made once, and taken up again where it was given up.

        elsewhere: other points to begin at where the fit from `start` (parameter,) leaves something.
        """
        key = _key(effects)
        made = self._fitted.get(key)
        if made is not None and not made.finished and not made.is_far_behind(rival):
            effects, start, offsets = made.effects, made.point, made.offsets
            del self._fitted[key]
        if key not in self._fitted:
            self._fitted[key] = self._fit_from([start, *elsewhere], effects, offsets, rival)
        return self._fitted[key]

    def _fit_from(
        self, starts: Sequence[np.ndarray], effects: Sequence[Placed], offsets: np.ndarray, rival: Fit | None
    ) -> Fit | None:
        """The best fit from `starts`, of which one is taken after the other until nothing is left."""
        found = None
        for start in starts:
            beaten = _least([found, rival])
            fit = self.fits.fit(self.fit_part, effects, start, offsets=offsets, seed=self.seed, rival=beaten)
            found = _least([found, fit])
            if found is not None and self.is_explained(found):
                break
        return found

    def _support(self, before_fit: Fit, fit: Fit, effect: Placed, before: PartFit | None, tried: int):
        """Support for `effect` in `fit` over `before_fit`, and how `fit` does on the select part."""
        added = max(len(effect[1].parameters), 1)  # to be there or not is a choice, too
        samples = self._effective_samples(fit)
        free = samples - len(fit.space)
        hypotheses = tried * self._candidate(placed_name(*effect)).shapes_tried
        p_fit = ratio_p_value(before_fit.squares, fit.squares, free, added, hypotheses)
        gain = bic_gain(before_fit.squares, fit.squares, samples, added)
        after = self.judge(fit)
        if after is None:
            return Support(p_fit, 0.0, gain, 0.0), None
        ratio = float(after.squares.sum() / before.squares.sum())
        return Support(p_fit, self._paired(before, after), gain, ratio), after

    def judge(self, fit: Fit) -> PartFit | None:
        """The model on windows that it is not fitted to; refitted for each fold where there are several."""
        if not self.folds.folds:
            return None
        if fit not in self._judged:
            self._judged[fit] = self._judge(fit)
        return self._judged[fit]

    def _judge(self, fit: Fit) -> PartFit:
        parts = []
        for fitted, judged in self.folds.folds:
            own = fit
            if len(self.folds.folds) > 1:
                train = self.fits.prepared.part(fitted)
                own = self.fits.fit(train, fit.effects, fit.point, seed=self.seed) or fit
            parts.append(self.fits.on(self.fits.prepared.part(judged), own))
        return parts[0] if len(parts) == 1 else PartFit.concatenate(parts)

    def _paired(self, before: PartFit, after: PartFit) -> float:
        length = int(np.ceil(BLOCK_TIMES * after.correlation_steps))
        return paired_p_value(before.blocks(length), after.blocks(length), self.seed)

    def _implausible(self, current: Fit, fit: Fit, candidate: Candidate) -> str | None:
        """Evidence against an effect that leaves something: at a bound, or driving a declared parameter to one.

        Where nothing is left, that is where they are. A declared parameter may fall to zero: then it had been standing
        in for the effect. Nor does it count where the log hardly determines it: then it may be anywhere.
        """
        if self.is_explained(fit):
            return None
        x = fit.space.to_unit(fit.point)
        prefix = candidate.name + "."
        own = [i for i, n in enumerate(fit.space.names) if n.startswith(prefix)]
        log = self.fits.prepared.log
        duration = max(log.time[e.stop - 1] - log.time[e.start] for e in log.episodes)
        doubt = candidate.effect[1].doubt(fit.point[own], float(duration))
        if doubt:
            return doubt
        for i in own:
            null = (fit.space.nominal[i] - fit.space.low[i]) / fit.space.span[i]
            if min(x[i], 1 - x[i]) < AT_BOUND and abs(x[i] - null) > AT_BOUND:
                return (
                    f"it would have to be at the end of its range ({fit.space.names[i]} = {fit.point[i]:.3g})"
                )
        size = len(current.point)
        was = current.at.x
        determined = intervals(fit.at).identifiable
        for i in range(size):
            at_bound = min(x[i], 1 - x[i]) < AT_BOUND <= min(was[i], 1 - was[i])
            bound = fit.space.low[i] if x[i] < 0.5 else fit.space.high[i]
            if determined[i] and bound != 0 and at_bound:
                return f"it drives {fit.space.names[i]} to its bound ({fit.point[i]:.3g})"
        return None

    def _choose(self, supported: list[Candidate], unfitted: list[Candidate]) -> Candidate:
        """The best of the candidates that are supported; among those it cannot be told from, the simplest, and then
        the one that fits best.

        The others are its rivals, and so are those not fitted whose response is nearly its own.
        """
        best = min(supported, key=self._loss)
        alike = [c for c in supported if c is best or self._as_good(best, c)]
        chosen = min(alike, key=lambda c: (len(c.effect[1].parameters), c.fit.squares))
        rivals = sorted((c for c in supported if c is not chosen), key=self._loss)
        for candidate in rivals:
            candidate.why_rejected = f"{chosen.name} explains as much with less, or more"
        alike = [c for c in unfitted if abs(similarity(chosen.score.response, c.score.response)) > SIMILAR]
        self.accepted.append(Accepted(chosen.effect, [*rivals[:RIVALS], *alike[:RIVALS]], chosen.support))
        return chosen

    def _as_good(self, best: Candidate, other: Candidate) -> bool:
        """Whether neither the fitted windows nor those that judge tell `other` from `best`."""
        _, gain = self._more_and_gain(best, other)
        return gain > -CLEARLY_BETTER and self._indistinct(best, other)

    def _more_and_gain(self, mine: Candidate, other: Candidate) -> tuple[int, float]:
        """How many parameters `other` has more than `mine`, and what its fit gains by BIC."""
        more = len(other.effect[1].parameters) - len(mine.effect[1].parameters)
        samples = self._effective_samples(other.fit)
        return more, bic_gain(mine.fit.squares, other.fit.squares, samples, more)

    def _loss(self, candidate: Candidate) -> float:
        """Mean logarithm of the squared error per step over blocks: what the paired test compares."""
        if candidate.select is None:
            return float(np.log(candidate.fit.squares))
        length = int(np.ceil(BLOCK_TIMES * candidate.select.correlation_steps))
        return float(np.log(np.maximum(candidate.select.blocks(length), TINY)).mean() - np.log(length))

    def _indistinct(self, best: Candidate, other: Candidate) -> bool:
        has_sizes = best.effect[1].parameters and other.effect[1].parameters
        if has_sizes and similarity(best.score.response, other.score.response) > SAME_RESPONSE:
            return True
        if best.select is None:
            ratio = other.fit.squares / best.fit.squares
            return bool(self._effective_samples(best.fit) * abs(np.log(ratio)) < 4.0)
        first, second = (best, other) if self._loss(best) <= self._loss(other) else (other, best)
        return self._paired(second.select, first.select) > INDISTINCT

    @staticmethod
    def _effective_samples(fit: Fit) -> float:
        evidence = fit.at.evidence
        residual = fit.at.residual.reshape(evidence.measured.shape)
        return evidence.count / correlation_steps(residual, evidence.mask)

    # --- backward ---

    def _backward(self, current: Fit, judged: Sequence[Accepted], reason: Callable) -> Fit:
        """Drop, weakest first, the effects among `judged` that there is a `reason` against, given the others."""
        judged = list(judged)
        while judged:
            weakest, without = None, None
            for accepted in judged:
                self._step("drop", 0, 1)
                fit = self._without(current, accepted)
                if fit is None:
                    continue
                before = self.judge(fit)
                tried = len(self.candidates)
                accepted.support, _ = self._support(fit, current, accepted.effect, before, tried)
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
            self.stages.append((f"- {weakest.name}", current))
        return current

    def _without(self, current: Fit, accepted: Accepted) -> Fit | None:
        effects = [e for e in current.effects if placed_name(*e) != accepted.name]
        keep = [i for i, n in enumerate(current.space.names) if not n.startswith(accepted.name + ".")]
        return self._fit(effects, current.point[keep], current.offsets)

    def nested(self, last: Fit, count: int) -> Fit:
        """The fit of the declared model with the first `count` effects of `last`."""
        effects = last.effects[:count]
        size = len(self.fits.prepared.task.space) + sum(len(e.parameters) for _, e in effects)
        return self._fit(effects, last.point[:size], last.offsets) or last

    def _candidate(self, name: str) -> Candidate:
        return next(c for c in self.candidates if c.name == name)

    # --- ties ---

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
            best, others = self._best(self._candidate_of(current, accepted), others)
            for other in others:
                verdict = self._compare(best, other)
                self._candidate(other.name).why_rejected = verdict.format(mine=best.name)
                if verdict == TIED:
                    accepted.tied.append(other)
            if best.name != accepted.name:
                self._candidate(best.name).why_rejected = None
                accepted.effect, accepted.support, current = best.effect, best.support, best.fit
                self.stages.append((f"{best.name} instead", current))
        return current

    def _best(self, mine: Candidate, others: list[Candidate]) -> tuple[Candidate, list[Candidate]]:
        """The candidate that no other is better than, and the others. None that was beaten comes back."""
        beaten: list[Candidate] = []
        while True:
            left = [c for c in others if not any(c is b for b in beaten)]
            better = next((c for c in left if self._compare(mine, c) == BETTER), None)
            if better is None:
                return mine, others
            beaten.append(mine)
            mine, others = better, [mine, *(c for c in others if c is not better)]

    def _compare(self, mine: Candidate, other: Candidate) -> str:
        """BETTER, TIED or why not, of `other` in the place of `mine`."""
        more, gain = self._more_and_gain(mine, other)
        if more > 0 and gain < CLEARLY_BETTER:
            return NOT_WORTH_IT
        if abs(gain) > BARE_MENTION and not self._indistinct(mine, other):
            return WORSE if self._loss(mine) <= self._loss(other) else BETTER
        if abs(gain) > CLEARLY_BETTER:
            return WORSE if gain < 0 else BETTER
        return TIED

    def _candidate_of(self, fit: Fit, accepted: Accepted) -> Candidate:
        select = self.judge(fit)
        own = self._candidate(accepted.name)
        return Candidate(accepted.effect, own.score, own.start, fit, select, accepted.support)

    def _swapped(self, current: Fit, accepted: Accepted, rival: Candidate) -> Candidate | None:
        """The model with `rival` in the place of `accepted`, if the rival is supported there."""
        without = self._without(current, accepted)
        if without is None:
            return None
        rest = without.effects
        fit = self._fit(
            [*rest, rival.effect], np.concatenate([without.point, rival.start]), without.offsets, current
        )
        if fit is None:
            return None
        before = self.judge(without)
        support, select = self._support(without, fit, rival.effect, before, len(self.candidates))
        found = Candidate(rival.effect, rival.score, rival.start, fit, select, support)
        if support.reason_against() or self._implausible(without, fit, found):
            return None
        return found


def _key(effects: Sequence[Placed]) -> frozenset[str]:
    """What a model is known by: its effects, in any order."""
    return frozenset(placed_name(*e) for e in effects)


def _worth_a_refit(ranked: Sequence[Candidate]) -> tuple[list[Candidate], list[Candidate]]:
    """The candidates to fit jointly, and the others; ranked: by score, best first."""
    kinds: list[list[Candidate]] = []
    refitted, others = [], []
    for candidate in ranked:
        own = next((k for k in kinds if _alike(k[0], candidate)), None)
        full = len(kinds) == DIFFERENT if own is None else len(own) == OF_A_KIND
        if full or len(refitted) == REFITTED:
            others.append(candidate)
            continue
        if own is None:
            kinds.append([])
        (kinds[-1] if own is None else own).append(candidate)
        refitted.append(candidate)
    return refitted, others


def _alike(a: Candidate, b: Candidate) -> bool:
    return abs(similarity(a.score.response, b.score.response)) > ALIKE


def _least(fits: Sequence[Fit | None]) -> Fit | None:
    """The fit that leaves least, the first of those that leave as much."""
    return min((f for f in fits if f is not None), key=lambda f: f.squares, default=None)


def _at_another_peak(effect: Effect, starts: Sequence[np.ndarray]) -> np.ndarray | None:
    """The first of `starts`, best first, with another period than the first: a fit goes no further than one peak."""
    if not isinstance(effect, PeriodicForce):
        return None
    shapes = [i for i, n in enumerate(effect.space.names) if n in effect.shapes]
    return next((s for s in starts[1:] if not np.array_equal(s[shapes], starts[0][shapes])), None)


def _slight(current: Fit, fit: Fit) -> str | None:
    """Why `fit` is no explanation of what `current` leaves above the noise, or None."""
    excess = current.error**2 - 1
    taken = current.error**2 - fit.error**2
    if taken >= MATERIAL * excess:
        return None
    return f"it takes {taken / excess:.1%} of what is above the noise floor: that is no explanation of it"


def _shapes(narrow: NarrowShapes, effect: Effect) -> tuple[np.ndarray, int]:
    """Points (point, parameter) with null amplitudes at which to score, and how many they were chosen from."""
    if isinstance(effect, PeriodicForce):
        return narrow.points(effect)
    grid = effect.shape_grid(SHAPES if len(effect.shapes) < 2 else SHAPES_OF_SEVERAL)
    return grid, len(grid)


def _probes(
    effect: Effect, amplitudes: list[int], shapes: np.ndarray, shares: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Probe points (probe, parameter), one per amplitude after the other, and their steps in ranges (probe,).

    An effect without amplitudes is probed as a whole, as far as a linear step may go.
    """
    if not amplitudes:
        return shapes, np.full(len(shapes), STEP)
    space = effect.space
    points, steps = [], []
    above, below = (space.high - space.nominal) / space.span, (space.nominal - space.low) / space.span
    two_sided = any(min(above[i], below[i]) >= max(shares) for i in amplitudes)
    for shape in shapes:
        for share in shares if two_sided else [s for s in shares if s > 0]:
            for i in amplitudes:
                point = shape.copy()
                step = share if (above if share > 0 else below)[i] >= abs(share) else -share
                point[i] = space.nominal[i] + step * space.span[i]
                points.append(point)
                steps.append(step)
    return np.array(points), np.array(steps)


def _thinned(part: PreparedLog, fit: Fit):
    """At most SCORED_WINDOWS windows of the part, and the fit's linearization on them."""
    count = len(part.windows)
    if count <= SCORED_WINDOWS:
        return part, fit.at
    keep = np.unique(np.linspace(0, count - 1, SCORED_WINDOWS).astype(int))
    thinned = part.part(keep)
    at = fit.at
    rows = thinned.windows.measured.shape[1] * thinned.windows.measured.shape[2]
    evidence = replace(at.evidence.rows(keep), measured=thinned.windows.measured, mask=thinned.windows.mask)
    return thinned, replace(
        at,
        evidence=evidence,
        offsets=at.offsets[keep],
        residual=at.residual[keep, :rows],
        by_parameter=at.by_parameter[keep, :rows],
        by_start=at.by_start[keep, :rows],
    )
