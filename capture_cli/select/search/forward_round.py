"""One round of forward selection: score every candidate, fit the model with each of the best, choose one that holds."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.processes import in_processes
from capture_cli.estimate.fit import Fit, least, thinned
from capture_cli.estimate.model_fits import Effort
from capture_cli.model.effects.base import GLOBAL
from capture_cli.select.candidates import Candidate, gain_of, score_at_null, take, told, worth_a_refit
from capture_cli.select.fit_checks import SETTINGS as FIT_CHECKS
from capture_cli.select.fit_checks import (
    leaves_something,
    needed_error,
    no_gain,
    slight,
)
from capture_cli.select.model_comparison import FittedSet, ModelComparison
from capture_cli.select.narrow_peaks import NarrowPeaks
from capture_cli.select.reason import Reason, Rejection
from capture_cli.select.score_checkpoint import kept_scores
from capture_cli.select.search.round import Round, by_score


@frozen
class SETTINGS:
    # of the share that a fit has to take, what its score has to promise where another effect is known
    promised: float = 0.2


# Before it is said that nothing explains the log, the next best are fitted, as often as there are pairs here: those of
# this share of the best score, which have to take this share of what is above the noise floor. Where contacts make the
# error rough, and where a declared parameter has to make way, a score at null says little; but what begins with next to
# none of it is believed only where it explains nearly all.
FURTHER = (0.2, FIT_CHECKS.material), (0.2, FIT_CHECKS.material), (0.1, 0.9)


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
    return fewer and coarser.rejection is not None and coarser.name not in held


class ForwardRound(Round):
    """What may be added to the model `current`, of candidates that are not in it.

    patient: whether the next best are fitted, too, where the best do not hold.

    scored: the model with what it leaves of the windows that scores are taken on. Among the supported sets are laws at
    all of the places where they hold, which may take little at each.
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
        super().__init__(models, current, candidates, rival=rival, on_step=on_step)
        Scores(models, current, on_step).score(candidates)
        _, at = thinned(models.fit_part, current)
        self.scored = replace(current, at=at)
        self.ranked = by_score(candidates)
        self._held: dict[str, FittedSet] = {}  # by its effect: on what judges, however little it takes
        self._fit_best(patient=patient)
        if not any(models.is_explained(s.fit) for s in self.supported):
            self._at_places()

    def _fit_best(self, *, patient: bool) -> None:
        """Fit candidates, those that their scores put first, until some are supported."""
        least_gain = 0.0 if patient else self._promised(FIT_CHECKS.material)
        refitted, others = worth_a_refit([c for c in self.ranked if c.score.gain >= least_gain])
        self._refit_all(refitted, FIT_CHECKS.material)
        for worth, material in FURTHER:
            if self.supported or not patient or not others:
                break
            least_gain = worth * self.ranked[0].score.gain
            refitted, left = worth_a_refit([c for c in others if c.score.gain > least_gain])
            others = [*left, *(c for c in others if c.score.gain <= least_gain)]
            self._refit_all(refitted, material)

    def _promised(self, material: float) -> float:
        """The gain of a score that is a reason to fit where another effect is known: a share of what is `material`."""
        return gain_of(SETTINGS.promised * material, self.scored)

    def _refit_all(self, candidates: Sequence[Candidate], material: float) -> None:
        """Fit the model with each of the candidates in it; supported are those that hold, and take `material`."""
        # fits with hidden states take long: they come last, and are stopped early where they stay far behind, or
        # promise less than is asked of them
        for number, candidate in enumerate(sorted(candidates, key=_cost)):
            self.on_step("refit", number, len(candidates))
            coarser = next((c for c in candidates if _settles(c, candidate, self._held)), None)
            if coarser is None:
                candidate.rejection = self._refit(candidate, material)
            else:
                candidate.rejection = Rejection(Reason.COARSER_DOES_NOT_HOLD, {"rival": coarser.name})

    def _refit(self, candidate: Candidate, material: float) -> Rejection | None:
        """Fit the model with the candidate in it, and judge; returns why it is out, or None. Stopped early where it
        stays far behind the best so far, or where its hidden states do not promise to take `material`.
        """
        current, added = self.current, (candidate.placed,)
        needed = needed_error(current, material) if candidate.placed.effect.states else np.inf
        # the current parameters, moved along with the effect's linear step
        declared = current.space.from_unit(current.at.x + candidate.score.parameters)
        starts = [s for s in (candidate.start, candidate.start_elsewhere) if s is not None]
        starts = [np.concatenate([declared, s]) for s in starts]
        effort = Effort(rival=self._best, needed=min(needed, self.useful_error), escapes=False)
        fit = self.models.fit([*current.effects, *added], starts[0], current, effort, starts[1:])
        if reason := no_gain(current, fit, self._best):
            return reason
        reason, found = self._out_of_range(added, fit), None
        if not (reason or self._may_hold(candidate, fit)):
            reason = self._little(fit, material)
        if not reason:
            reason, found = self._judged(added, fit)
        if found is not None:
            self._held[candidate.name], fit = found, found.fit
            reason = self._little(fit, material)
        self._best = least([self._best, fit])
        if not reason:
            self.supported.append(found)
            self.models.held.append(found)
        return reason

    def _may_hold(self, candidate: Candidate, fit: Fit) -> bool:
        """Whether what judges has a say, which takes longer than the fit, however little that takes: its law may hold
        at several places, and an escape may lead on.
        """
        places = self._places(candidate.placed.law, self.ranked)
        return len(places) > 1 or self.models.may_escape(fit, self._best, self.useful_error)

    def _little(self, fit: Fit, material: float) -> Rejection | None:
        """What is said against a fit by how little it takes."""
        return slight(self.current, fit, material) or leaves_something(self.current, fit, self.useful_error)

    @staticmethod
    def _places(law: str, candidates: Sequence[Candidate]) -> list[Candidate]:
        """The first of the candidates at each place where a law may be."""
        places = {
            c.placed.effect.variant_of: c
            for c in reversed(candidates)
            if c.placed.law == law and c.placed.effect.site != GLOBAL
        }
        return list(places.values())

    def _at_places(self) -> None:
        """Laws that hold somewhere at all of the places that scores speak for, at once, or at all of those where they
        hold.
        """
        held = [self.candidates[name] for name in self._held]
        laws = dict.fromkeys(c.placed.law for c in held)
        for number, law in enumerate(laws):
            self.on_step("law at all places", number, len(laws))
            best = least([self._held[c.name].fit for c in held if c.placed.law == law])
            for some in (self.ranked, held):
                places = self._places(law, some)
                if len(places) > 1 and (found := self._together(places, best)):
                    self.supported.append(found)
                    break

    def _together(self, places: Sequence[Candidate], best: Fit) -> FittedSet | None:
        """All of the candidates in one model, but those that have to be at an end of their range there; None where that
        does not hold, or something with no more parameters leaves less. best: of the fits with one of them that holds.
        """
        current, added = self.current, tuple(c.placed for c in places)
        own = [c.start for c in places]
        for i, candidate in enumerate(places):
            if candidate.name in self._held:
                fit = self._held[candidate.name].fit
                own[i] = fit.point[fit.columns(candidate.name)]
        start = np.concatenate([best.point[: len(current.point)], *own])
        best = least([best, *(s.fit for s in self.supported if len(s.fit.point) <= len(start))])
        needed = min(best.error, needed_error(current, FIT_CHECKS.material))
        effort = Effort(needed=needed, escapes=False)
        fit = self.models.fit([*current.effects, *added], start, current, effort)
        if fit is None or fit.penalised_squares >= best.penalised_squares:
            return None
        plausible = [c for c in places if not self._out_of_range([c.placed], fit)]
        if 1 < len(plausible) < len(places):
            return self._together(plausible, best)
        if len(plausible) < len(places) or slight(current, fit, FIT_CHECKS.material):
            return None
        return self._judged(added, fit)[1]
