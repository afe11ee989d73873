"""What could be there in the place of an effect: rivals are asked for, put in its place, and tied with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.balance.balanced_model import BalancedModel
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.model_fits import Effort
from capture_cli.model.effects.placed import Placed
from capture_cli.select.balance_scores import score_in_balance
from capture_cli.select.candidates import Candidate, worth_a_refit
from capture_cli.select.fit_checks import as_good_error, out_of_range
from capture_cli.select.reason import Reason, Rejection
from capture_cli.select.score import Score
from capture_cli.select.search.answer import SETTINGS as ANSWER
from capture_cli.select.search.answer import Accepted, Answer
from capture_cli.select.search.extension import NOT_ASKED
from capture_cli.select.search.forward_round import Scores
from capture_cli.select.search.round import SETTINGS as ROUND
from capture_cli.select.search.round import by_score, do_the_same, reject_at_first_sight


@frozen
class SETTINGS:
    # of an effect's score, with the others in: what has more may be what is there in its place
    as_much: float = 0.8
    # of the variance of the sensors' noise: what the balance of a model leaves beyond it, whose scores then tell
    # little where simulations leave nothing
    contradicts: float = 1.0


class Rivals:
    """Of the effects of an answer."""

    def __init__(self, answer: Answer):
        self.answer, self.models = answer, answer.models

    def ask(self, current: Fit) -> None:
        """Rivals of accepted effects, by what the model without it leaves with the others in.

        What spoke for one while others were missing may have been theirs. The last that came was asked then, among what
        was as good as the best: it need not have been that, where that is what no simulation can do. So it is asked
        again where it explains the log. Of a law at several places one place is asked. What explains the log in its
        place is a rival whatever the balance says.
        """
        asked: set[tuple[str, str]] = set()
        explained = self.models.is_explained(current)
        for number, accepted in enumerate(self.answer.accepted):
            if accepted.placed.law in asked:
                continue
            asked.add(accepted.placed.law)
            self.answer.step("rivals", number, len(self.answer.accepted))
            if explained or accepted is not self.answer.accepted[-1] or not accepted.rivals:
                self.ask_of(current, accepted)
            if explained:
                self._ask_simulations_for_rivals(current, accepted)

    def ask_of(self, current: Fit, accepted: Accepted) -> None:
        """Those of one accepted effect, by what the model without it leaves."""
        without = self.models.without(current, accepted.name)
        screening = self.models.screening_about(current, self.answer.step)
        by_simulation = screening is None or self._contradicts_balance(current)
        if without is None or not (by_simulation or accepted.name in screening.covered):
            return
        inside = {a.name for a in self.answer.accepted} - {accepted.name}
        candidates = [replace(c) for c in self.answer.beside(inside)]
        rest = self._rest(current, accepted, without)
        polished = None if self.models.is_explained(current) else ROUND.rivals
        ranked = self._scored(without, rest, candidates, by_simulation=by_simulation, polished=polished)
        mine = next((c for c in ranked if c.name == accepted.name), None)
        if mine is None:
            return
        known = {r.name for r in accepted.rivals} | self.models.explaining_with(inside)
        known.discard(accepted.name)
        others = [c for c in ranked if c is not mine and c.name not in known]
        new = [c for c in others if _may_rival(mine.score, c.score)]
        if self.models.is_explained(current):
            # what was fitted does not explain it; and what is alike in the balance need not be in a simulation
            new = [c for c in new if not self.models.is_fitted([*without.effects, c.placed])]
            new = new[: ANSWER.likeliest]
            fitted = {c.name for c in new} | known | inside
            new += [c for c in self._at_the_other_end(current, accepted) if c.name not in fitted]
        else:
            new = worth_a_refit(new)[0][: ROUND.rivals]
        accepted.score = mine.score
        accepted.rivals = [*(c for c in ranked if c.name in known), *new]

    def _at_the_other_end(self, current: Fit, accepted: Accepted) -> list[Candidate]:
        """Of an effect on controls those of the same law on sensors, and the reverse, as large: a command that is late
        moves what follows it linearly as a sensor does that is late. The balance has those of sensors to first order.
        """
        other_end = {"control": "measurement", "measurement": "control"}.get(accepted.placed.effect.place)
        same, start = _numbers(accepted.placed), current.point[current.columns(accepted.name)]
        return [
            replace(c, score=None, start=start, start_elsewhere=None)
            for c in self.answer.candidates
            if c.placed.effect.place == other_end and _numbers(c.placed) == same
        ]

    def _ask_simulations_for_rivals(self, current: Fit, accepted: Accepted) -> None:
        """Those of an effect that the balance found, among what simulations alone tell of, scored beside it by these:
        soft friction and friction that holds at first like a spring do the same.
        """
        without = self.models.without(current, accepted.name)
        screening = self.models.screening(self.answer.step)
        if without is None or screening is None or accepted.name not in screening.covered:
            return
        mine = replace(self.answer.candidate(accepted.name))
        asked = {r.name for r in accepted.rivals} | screening.decided
        others = [replace(c) for c in self.answer.outside if c.name not in asked]
        Scores(self.models, without, self.answer.step).score([mine, *others])
        ranked = by_score(others)
        # near null these may see little of what the balance found, whose own score is no measure of others then
        most = max(
            (c for c in (mine, *ranked[:1]) if c.score is not None), key=lambda c: c.score.gain, default=mine
        )
        explaining = self.models.explaining_with({a.name for a in self.answer.accepted} - {accepted.name})
        new = [
            c
            for c in ranked
            if c.name in explaining
            or _may_rival(most.score, c.score)
            or (mine.score is not None and do_the_same(mine.score, c.score))
        ][: ROUND.rivals]
        accepted.rivals = [*accepted.rivals, *new]
        reject_at_first_sight([c for c in ranked if c not in new], [most])
        for candidate in others:
            does_not_hold = Rejection(Reason.DOES_NOT_HOLD, {"place": accepted.name})
            own = self.answer.candidate(candidate.name)
            if own.rejection in (None, NOT_ASKED):
                own.rejection = candidate.rejection or does_not_hold

    def _rest(self, current: Fit, accepted: Accepted, without: Fit) -> Fit:
        """The model `without` an accepted effect: where the others are in the `current` model, if that explains the
        log, for fitted alone they may have stood in for the effect.
        """
        if not self.models.is_explained(current):
            return without
        return replace(without, point=np.delete(current.point, current.columns(accepted.name)))

    def _scored(
        self,
        fitted: Fit,
        moved: Fit,
        candidates: Sequence[Candidate],
        *,
        by_simulation: bool,
        polished: int | None,
    ) -> list[Candidate]:
        """Those of the candidates that their scores speak for, best first: in the force balance about the `moved`
        model, so many `polished`, or, where that gives none, or by_simulation, through simulations of the `fitted` one.
        """
        screening = self.models.screening_about(moved, self.answer.step, moved=moved is not fitted)
        if screening is None or by_simulation:
            Scores(self.models, fitted, self.answer.step).score(candidates)
            return by_score(candidates)
        candidates = [c for c in candidates if c.name in screening.covered]
        score_in_balance(screening, moved, candidates, polished)
        return by_score(candidates)

    def _contradicts_balance(self, current: Fit) -> bool:
        """Whether simulations of the model explain the log, and the force balance does not: between commands that are
        held for long a joint moves as its rows do not show.
        """
        screening = self.models.screening_about(current, self.answer.step)
        if screening is None or not self.models.is_explained(current):
            return False
        declared = current.point[: len(self.models.fits.prepared.task.space)]
        model = BalancedModel(tuple(current.effects), declared, tuple(current.values))
        return screening.fits.judged(model).beyond_noise > SETTINGS.contradicts

    def compare(self, current: Fit, some: Sequence[Accepted]) -> Fit:
        """Put rivals of `some` accepted effects in their places: swap where one is better, tie where none can tell."""
        for accepted in some:
            inside = {a.name for a in self.answer.accepted}
            accepted.tied, others = [], []
            possible = {c.name for c in self.answer.beside(inside - {accepted.name})} - inside
            for number, rival in enumerate(r for r in accepted.rivals if r.name in possible):
                self.answer.step("compare", number, len(accepted.rivals))
                other = self._swapped(current, accepted, rival)
                if other is not None:
                    others.append(other)
            best, others = self.models.best(self._candidate_of(current, accepted), others)
            best, others = self.models.best(best, [self._again_from(best, other) for other in others])
            for other in others:
                reason = self._why_no_better(best, other)
                self.answer.candidate(other.name).rejection = Rejection(reason, {"best": best.name})
                if reason == Reason.TIED:
                    accepted.tied.append(other)
            if best.name != accepted.name:
                self.answer.candidate(best.name).rejection = None
                tried = {best.name, *(other.name for other in others)}
                accepted.rivals = [*others, *(r for r in accepted.rivals if r.name not in tried)]
                accepted.placed, accepted.score, accepted.support = best.placed, best.score, best.support
                current = best.fit
        return current

    def _why_no_better(self, best: Candidate, other: Candidate) -> Reason:
        """What speaks against `other` in the place of the `best`: one that was beaten may do better than that again."""
        reason = self.models.compare(best, other)
        if reason == Reason.TIED and _are_steps(best.placed, other.placed):
            return Reason.STEPS_AS_WELL
        if reason == Reason.EXPLAINS_LESS and self.models.is_explained(other.fit):
            return Reason.EXPLAINS_ENOUGH
        return reason or Reason.BEATEN

    def _candidate_of(self, fit: Fit, accepted: Accepted) -> Candidate:
        start, select = fit.point[fit.columns(accepted.name)], self.models.judge(fit)
        return Candidate(accepted.placed, accepted.score, start, fit, select, accepted.support)

    def _swapped(self, current: Fit, accepted: Accepted, rival: Candidate) -> Candidate | None:
        """The model with `rival` in the place of `accepted`, if the rival is supported there."""
        without = self.models.without(current, accepted.name)
        if without is None:
            return None
        rest = self._rest(current, accepted, without)
        start, *elsewhere = (np.concatenate([f.point, rival.start]) for f in dict.fromkeys([without, rest]))
        effects = [*without.effects, rival.placed]
        effort = Effort(rival=current, needed=as_good_error(current))
        fit = self.models.fit(effects, start, without, effort, elsewhere)
        if fit is None:
            return None
        found = self._with_fit(rival, without, fit)
        if found.support.reason_against() or out_of_range(self.models, without, fit, found.placed):
            return None
        return found

    def _with_fit(self, candidate: Candidate, without: Fit, fit: Fit) -> Candidate:
        """The candidate with a fit that has it, and its support there over the fit `without` it."""
        support, select = self.answer.support(without, fit, [candidate])
        return replace(candidate, fit=fit, select=select, support=support)

    def _again_from(self, best: Candidate, other: Candidate) -> Candidate:
        """`other`, fitted again from where the `best` ended if that has more parameters: it may be a limit of it."""
        if len(other.fit.point) >= len(best.fit.point):
            return other
        again = self.models.better_from(other.fit, best.fit)
        without = again and self.models.without(again, other.name)
        return self._with_fit(other, without, again) if without else other


def _may_rival(mine: Score, other: Score) -> bool:
    """Whether the effect of the `other` score may be what is there in the place of mine: it has as much of what is left
    to say, or does nearly the same.
    """
    return other.gain > SETTINGS.as_much * mine.gain or do_the_same(mine, other)


def _numbers(placed: Placed) -> list[tuple[str, str]]:
    """Names and units of its parameters: of the same law on a control as on a sensor they are the same."""
    return [(p.name, p.unit) for p in placed.effect.parameters]


def _are_steps(one: Placed, other: Placed) -> bool:
    """Whether both are, of two lengths: no experiment would tell them apart."""
    return one.kind == other.kind and one.is_shorter_step
