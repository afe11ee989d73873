"""One round of forward selection: score every candidate, fit the model with each of the best, choose one that holds."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.processes import in_processes
from capture_cli.common.similarity import similarity
from capture_cli.estimate.fit import Fit, least, thinned
from capture_cli.estimate.model_fits import Effort
from capture_cli.estimate.part_fit import PartFit
from capture_cli.model.effects.base import GLOBAL
from capture_cli.select.candidates import Candidate, gain_of, score_at_null, take, told, worth_a_refit
from capture_cli.select.model_comparison import FittedSet, ModelComparison
from capture_cli.select.narrow_peaks import NarrowPeaks
from capture_cli.select.rejection import SETTINGS as REJECTION
from capture_cli.select.rejection import (
    leaves_something,
    needed_error,
    no_gain,
    out_of_range,
    slight,
)
from capture_cli.select.score import Score
from capture_cli.select.score_checkpoint import kept_scores


@frozen
class SETTINGS:
    # other candidates that an accepted effect is compared with once everything else is in the model
    rivals: int = 4
    # of the share that a fit has to take, what its score has to promise where another effect is known
    promised: float = 0.2
    # cosine of responses beyond which a candidate that was not fitted may still be a rival
    similar: float = 0.97


# Before it is said that nothing explains the log, the next best are fitted, as often as there are pairs here: those of
# this share of the best score, which have to take this share of what is above the noise floor. Where contacts make the
# error rough, and where a declared parameter has to make way, a score at null says little; but what begins with next to
# none of it is believed only where it explains nearly all.
FURTHER = (0.2, REJECTION.material), (0.2, REJECTION.material), (0.1, 0.9)


class Scores:
    """How much each candidate would explain of what the model `current` leaves, judged at null."""

    def __init__(self, models: ModelComparison, current: Fit, on_step: Callable[[str, int, int], None]):
        self.models = models
        self.current = current
        self.on_step = on_step

    @kept_scores
    def score(self, candidates: Sequence[Candidate]) -> None:
        """Fill in the candidates' scores."""
        fits = self.models.fits
        part, at = thinned(self.models.fit_part, self.current)
        narrow = NarrowPeaks(fits, part, replace(self.current, at=at))
        narrow.respond_to(c.placed.effect for c in candidates)
        rollouts = fits.rollouts

        def scored(candidate: Candidate) -> tuple[dict[str, Any], int]:
            before = fits.rollouts
            score_at_null(narrow, candidate)
            return told(candidate), fits.rollouts - before

        found = in_processes(scored, candidates, fits.engine.threads)
        for number, candidate in enumerate(candidates):
            self.on_step("score", number, len(candidates))
            values, own = next(found)
            take(candidate, values.get)
            rollouts += own
        fits.rollouts = rollouts


def _cost(candidate: Candidate) -> tuple[int, int]:
    """What a fit with it takes: hidden states, then steps of the model."""
    effect = candidate.placed.effect
    return len(effect.states), effect.substeps


def _settles(coarser: Candidate, candidate: Candidate, held: Collection[str]) -> bool:
    """Whether both are the model in shorter steps, and the `coarser` ones were fitted and are not among those that
    `held`: to first order the error of a step falls with its length, so that half a step takes at least half of what
    any other does.
    """
    fewer = 1 < coarser.placed.effect.substeps < candidate.placed.effect.substeps
    return fewer and coarser.why_rejected is not None and coarser.name not in held


def by_score(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Those that their scores speak for, best first."""
    return sorted((c for c in candidates if c.why_rejected is None), key=lambda c: -c.score.gain)


def do_the_same(one: Score, other: Score) -> bool:
    """Whether two effects do so nearly the same that either may be there in the place of the other."""
    return abs(similarity(one.response, other.response)) > SETTINGS.similar


def alike_unfitted(unfitted: Sequence[Candidate], held: Sequence[Candidate]) -> list[Candidate]:
    """Of candidates that were not fitted, those that do nearly the same as one of those that `held`."""
    alike = [c for c in unfitted if any(do_the_same(c.score, other.score) for other in held)]
    return [replace(c) for c in alike[: SETTINGS.rivals]]


def reject_at_first_sight(candidates: Sequence[Candidate], ranked: Sequence[Candidate]) -> None:
    """Say of candidates that were not worth a fit by how much the best of the `ranked` is ahead of them."""
    for candidate in candidates:
        gain, most = candidate.score.gain, ranked[0].score.gain
        candidate.why_rejected = f"explains no more at first sight ({gain:.3g}; {most:.3g} the best)"


class ForwardRound:
    """What may be added to the model `current`.

    candidates: those that are not in it. patient: whether the next best are fitted, too, where the best do not hold.
    rival: of effects that are not among them; a fit that stays far behind it is stopped early. on_step is told what is
    being tried, the number of it, and of how many.

    scored: the model with what it leaves of the windows that scores are taken on. ranked: candidates that their scores
    speak for, best first. supported: those that hold on what judges, and laws at
    all of the places where they do, which may take little at each.
    """

    def __init__(
        self,
        models: ModelComparison,
        current: Fit,
        candidates: Sequence[Candidate],
        *,
        patient: bool,
        rival: Fit | None = None,
        on_step: Callable[[str, int, int], None],
    ):
        self.models = models
        self.current = current
        self.rival = rival
        self.useful_error = models.useful_error(current)
        self.tried = len(candidates)
        self.on_step = on_step
        Scores(models, current, on_step).score(candidates)
        _, at = thinned(models.fit_part, current)
        self.scored = replace(current, at=at)
        self.ranked = by_score(candidates)
        self._held: list[Candidate] = []  # on what judges, however little they take
        supported, self._unfitted = self._fitted(patient=patient)
        self.supported = [FittedSet((c.placed,), c.fit, c.select) for c in supported]
        if not any(models.is_explained(c.fit) for c in supported):
            self._at_places()

    def _fitted(self, *, patient: bool) -> tuple[list[Candidate], list[Candidate]]:
        """Candidates that are supported once they are fitted, and those that were not worth a fit."""
        least_gain = 0.0 if patient else self._promised(REJECTION.material)
        refitted, others = worth_a_refit([c for c in self.ranked if c.score.gain >= least_gain])
        others += [c for c in self.ranked if c.score.gain < least_gain]
        supported = self._refit_all(refitted, REJECTION.material)
        for worth, material in FURTHER:
            if supported or not patient or not others:
                break
            least_gain = worth * self.ranked[0].score.gain
            refitted, left = worth_a_refit([c for c in others if c.score.gain > least_gain])
            others = [*left, *(c for c in others if c.score.gain <= least_gain)]
            supported = self._refit_all(refitted, material)
        reject_at_first_sight(others, self.ranked)
        return supported, others

    def _promised(self, material: float) -> float:
        """The gain of a score that is a reason to fit where another effect is known: a share of what is `material`."""
        return gain_of(SETTINGS.promised * material, self.scored)

    def _refit_all(self, candidates: Sequence[Candidate], material: float) -> list[Candidate]:
        """Fit the model with each of the candidates in it; those that are supported, and take `material`."""
        before, best = self.models.judge(self.current), self.rival
        # fits with hidden states take long: they come last, and are stopped early where they stay far behind, or
        # promise less than is asked of them
        for number, candidate in enumerate(sorted(candidates, key=_cost)):
            self.on_step("refit", number, len(candidates))
            held = {c.name for c in self._held}
            if coarser := next((c for c in candidates if _settles(c, candidate, held)), None):
                candidate.why_rejected = (
                    f"{coarser.name} takes half of what this does, or more, and does not hold"
                )
                continue
            self._refit(candidate, before, best, material)
            best = least([best, candidate.fit])
            if candidate.why_rejected is None:
                self._held.append(candidate)
                reason = slight(self.current, candidate.fit, material)
                candidate.why_rejected = reason or leaves_something(
                    self.current, candidate.fit, self.useful_error
                )
            if candidate.why_rejected is None:
                self.models.held.append(FittedSet((candidate.placed,), candidate.fit, candidate.select))
        return [c for c in candidates if c.why_rejected is None]

    def _refit(
        self, candidate: Candidate, before: PartFit | None, rival: Fit | None, material: float
    ) -> None:
        """Fit the model with the candidate in it, and judge; stopped early where it stays far behind `rival`, or where
        its hidden states do not promise to take `material`.
        """
        current = self.current
        needed = needed_error(current, material) if candidate.placed.effect.states else np.inf
        needed = min(needed, self.useful_error)
        # the current parameters, moved along with the effect's linear step
        declared = current.space.from_unit(current.at.x + candidate.score.parameters)
        starts = [s for s in (candidate.start, candidate.start_elsewhere) if s is not None]
        starts = [np.concatenate([declared, s]) for s in starts]
        effects = [*current.effects, candidate.placed]
        effort = Effort(rival=rival, needed=needed, escapes=False)
        fit = self.models.fit(effects, starts[0], current, effort, starts[1:])
        if candidate.start_doubted is not None and (fit is None or not self.models.is_explained(fit)):
            start = np.concatenate([declared, candidate.start_doubted])
            fit = self.models.explained_from(start, effects, current) or fit
        if reason := no_gain(current, fit, rival):
            candidate.why_rejected = reason
            return
        candidate.fit = fit
        candidate.why_rejected = out_of_range(self.models, current, fit, candidate.placed)
        if candidate.why_rejected:
            return
        candidate.support, candidate.select = self.models.support_of(
            current, fit, [candidate], before, self.tried
        )
        candidate.why_rejected = candidate.support.reason_against_entry()
        if candidate.why_rejected is None:
            candidate.fit = self.models.escaped(fit, rival, self.useful_error)
            candidate.select = self.models.judge(candidate.fit)

    def _at_places(self) -> None:
        """Laws that hold somewhere at all of the places that scores speak for, at once, or at all of those where they
        hold.
        """
        laws = dict.fromkeys(c.placed.law for c in self._held)
        for number, law in enumerate(laws):
            self.on_step("law at all places", number, len(laws))
            best = least([c.fit for c in self._held if c.placed.law == law])
            for some in (self.ranked, self._held):
                places = {
                    c.placed.effect.variant_of: c
                    for c in reversed(some)
                    if c.placed.law == law and c.placed.effect.site != GLOBAL
                }
                if len(places) > 1 and (fitted := self._together(list(places.values()), best)):
                    self.supported.append(fitted)
                    break

    def _together(self, places: Sequence[Candidate], best: Fit) -> FittedSet | None:
        """All of the candidates in one model, but those that have to be at an end of their range there; None where that
        does not hold, or something with no more parameters leaves less. best: of the fits with one of them that holds.
        """
        current, added = self.current, tuple(c.placed for c in places)
        held = {c.name for c in self._held}
        own = [c.fit.point[c.fit.columns(c.name)] if c.name in held else c.start for c in places]
        start = np.concatenate([best.point[: len(current.point)], *own])
        best = least([best, *(s.fit for s in self.supported if len(s.fit.point) <= len(start))])
        needed = min(best.error, needed_error(current, REJECTION.material))
        effort = Effort(needed=needed, escapes=False)
        fit = self.models.fit([*current.effects, *added], start, current, effort)
        if fit is None or fit.penalised_squares >= best.penalised_squares:
            return None
        plausible = [c for c in places if not out_of_range(self.models, current, fit, c.placed)]
        if 1 < len(plausible) < len(places):
            return self._together(plausible, best)
        if len(plausible) < len(places) or slight(current, fit, REJECTION.material):
            return None
        support, _ = self.models.support_of(current, fit, places, self.models.judge(current), self.tried)
        if support.reason_against_entry():
            return None
        fit = self.models.escaped(fit, best, self.useful_error)
        return FittedSet(added, fit, self.models.judge(fit))

    def choose(self) -> tuple[FittedSet, list[Candidate]] | None:
        """The best of what is supported; among those it cannot be told from, the simplest, and then the one that fits
        best. With it, where it is one effect, its rivals: the others, and what was not fitted and does nearly the same
        as one of these.
        """
        supported = self.models.not_given_up(self.supported)
        if not supported:
            return None
        order = np.argsort(self.models.losses(supported), kind="stable")
        best = supported[order[0]]
        as_good = [s for s in supported if s is best or self.models.as_good(best, s)]
        chosen = min(as_good, key=lambda s: (len(s.fit.point), s.fit.penalised_squares))
        names, by_name = [e.name for e in chosen.added], {c.name: c for c in self.ranked}
        others = [supported[i] for i in order if len(supported[i].added) == 1]
        rivals = [by_name[s.added[0].name] for s in others if s.added[0].name not in names]
        for candidate in rivals:
            candidate.why_rejected = f"{' and '.join(names)} explains as much with less, or more"
        if len(names) > 1:
            return chosen, []
        rivals = [replace(c) for c in rivals[: SETTINGS.rivals]]
        return chosen, [*rivals, *alike_unfitted(self._unfitted, [by_name[names[0]], *rivals])]
