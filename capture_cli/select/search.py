"""Which effects? Ask the force balance for the best sets of them, fit those, accept what holds; then put each to test.

Where a log gives no balance, or where none of what the balance covers explains it, effects are scored one at a time by
simulations (`forward_round`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass, field, replace
from itertools import takewhile

import numpy as np
from scipy.special import chdtrc

from capture_cli.common.frozen import frozen
from capture_cli.errors import OutOfTime
from capture_cli.estimate.balance.balanced_model import BalancedModel
from capture_cli.estimate.balance.dictionary import acts_unshown
from capture_cli.estimate.balance.regression import SETTINGS as REGRESSION
from capture_cli.estimate.balance.screening import SETTINGS as SCREENING
from capture_cli.estimate.fit import Fit, thinned
from capture_cli.estimate.model_fits import Effort, ModelFits
from capture_cli.estimate.noise.lack_of_fit import SETTINGS as LACK_OF_FIT
from capture_cli.estimate.part_fit import PartFit
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.effects.placed import Placed, names_of
from capture_cli.select.balance_round import BalanceRound
from capture_cli.select.balance_scores import score_in_balance
from capture_cli.select.candidates import Candidate, all_candidates, worth_a_refit
from capture_cli.select.criterion import Support
from capture_cli.select.forward_round import SETTINGS as FORWARD_ROUND
from capture_cli.select.forward_round import ForwardRound, Scores
from capture_cli.select.log_parts import Folds
from capture_cli.select.model_comparison import SETTINGS as COMPARISON
from capture_cli.select.model_comparison import FittedSet, ModelComparison
from capture_cli.select.reason import Reason, Rejection
from capture_cli.select.rejection import SETTINGS as REJECTION
from capture_cli.select.rejection import as_good_error, out_of_range, slight
from capture_cli.select.round import SETTINGS as ROUND
from capture_cli.select.round import Choice, by_score, do_the_same, reject_at_first_sight
from capture_cli.select.score import Score


@frozen
class SETTINGS:
    most_effects: int = 6
    # how many that the balance puts first have their score test through the simulator, where it finds nothing, or are
    # compared with what is in the answer
    likeliest: int = 8
    # how often the score test may take the best of all candidates for an effect where nothing is missing
    by_chance: float = 0.01
    # of the score that a fit takes now: what simulations alone tell of is scored again where its last score was that
    asked_again: float = 0.5
    # of the squared error above the noise floor, what shorter steps may leave by their score, to be asked first
    left_by_steps: float = 0.5
    # gain of a score: less than chance gives whatever acts, but once in a thousand times
    acts: float = 1e-6
    # of an effect's score, with the others in: what has more may be what is there in its place
    as_much: float = 0.8
    # of the variance of the sensors' noise: what the balance of a model leaves beyond it, whose scores then tell
    # little where simulations leave nothing
    contradicts: float = 1.0


NOT_ASKED = Rejection(Reason.NOT_ASKED)


@dataclass
class Accepted:
    """An effect in the model, candidates that did as well when it entered, and how it stands in the last model.

    score: when it entered, and so are those of the rivals: later, with it in the model, they answer to what it leaves.
    share: of the squared error above the noise floor of the declared model, what it took when it entered.
    """

    placed: Placed
    score: Score | None
    rivals: list[Candidate]
    support: Support | None
    share: float
    tied: list[Candidate] = field(default_factory=list)

    @property
    def tied_with(self) -> list[str]:
        return [c.name for c in self.tied]

    @property
    def name(self) -> str:
        return self.placed.name


class Attribution:
    """Selection of effects: forward, backward, and against rivals.

    folds: what is fitted, and what judges; nothing judges where the log is one window long. most_effects: to add; a law
    at several places counts once. candidates: the whole catalogue where None; others are scored by simulations. on_step
    is told what is being tried, the number of it, of how many, and what was found so far; where it raises OutOfTime,
    the search ends with the last model that was whole.

    out_of_time: whether it ended so.
    """

    def __init__(
        self,
        fits: ModelFits,
        folds: Folds,
        *,
        seed: int,
        most_effects: int = SETTINGS.most_effects,
        candidates: Sequence[Candidate] | None = None,
        on_step: Callable[[str, int, int, Sequence[Placed]], None] = lambda *_: None,
    ):
        self.models = ModelComparison(fits, folds, seed=seed)
        self.most_effects = most_effects
        self.on_step = on_step
        self.given = candidates is not None
        self.candidates = all_candidates(fits.prepared) if candidates is None else list(candidates)
        self.models.candidates = self.candidates
        self.accepted: list[Accepted] = []
        self._told: set[str] = set()  # of an explained log, what simulations alone are sure of
        self._extended: set[frozenset[str]] = set()  # models, by their effects, that something was added to
        self._promised: dict[str, float] = {}  # by its last score through the simulator, squared noise floors
        self.out_of_time = False

    def run(self, declared: Fit) -> Fit:
        """Add effects to the declared model until none is accepted or nothing is left; returns the last model."""
        self._keep(declared)
        try:
            return self._search(declared)
        except OutOfTime:
            self.out_of_time = True
            last, self.accepted = self._whole
            last = self._with_what_holds(last)
            inside = {a.name for a in self.accepted}
            for candidate in self.candidates:
                if candidate.name not in inside and candidate.rejection is None:
                    candidate.rejection = Rejection(Reason.OUT_OF_TIME)
            return last

    def _with_what_holds(self, last: Fit) -> Fit:
        """`last`, with the best of what held in the round that was cut short. Nothing is simulated."""
        held = self.models.held
        return self._with(self.models.best_of(held), [], last) if held else last

    def _keep(self, current: Fit) -> Fit:
        """Take note of a model that is whole, and the effects in it; what held in its round is settled with it."""
        self.models.held = []
        self._whole = current, [replace(a, tied=list(a.tied)) for a in self.accepted]
        return current

    def _search(self, declared: Fit) -> Fit:
        """Where a rival in the place of an effect explains materially more, the search goes on from there; where it
        explains the log, with the rivals of that one.
        """
        self.models.know(declared)
        current, explaining = declared, set()
        while True:
            extended = self._without_minor(self._with_more(current))
            current = self._keep(self._backward(extended))
            if current is not extended and not self.models.is_explained(current):
                continue  # what was dropped may have stood in for another
            self._ask_again(current)
            compared = self._compare_with_rivals(current, self.accepted)
            if compared is current:
                return self._keep(current)
            explaining.add(names_of(current.effects))
            # with another in its place an effect may have nothing left to do
            before, current = current, self._backward(compared)
            self._keep(current)
            if self.models.is_explained(current):
                if names_of(current.effects) in explaining:
                    return current
            elif slight(before, current, REJECTION.material):
                return current

    def _with_more(self, current: Fit) -> Fit:
        """The model with what can be added to it."""
        while self._may_extend(current):
            known = len(self.accepted)
            if not known:
                self.models.excess = max(current.excess, REGRESSION.tiny)
            self._extended.add(names_of(current.effects))
            found = self._next(current)
            if found is None:
                break
            current = self._keep(self._split(found, self.accepted[known:]))
        return current

    def _may_extend(self, current: Fit) -> bool:
        new = names_of(current.effects) not in self._extended
        return new and self._count < self.most_effects and self._is_missing(current)

    def _is_missing(self, current: Fit) -> bool:
        """Whether more is left than chance allows; or, of the declared model, an effect predicts blocks that no fit saw
        so much better that chance does not, or has a score test that is beyond it: parameters that stand in for it may
        leave next to nothing. What an effect that was found leaves of so little would be corrected, not explained.
        """
        self._told = set()
        explained = self.models.is_explained(current)
        if self.accepted or not explained:
            return not explained
        screening = self.models.screening_about(current, self._step)
        additions, tried, uncovered = [], 0, self._outside
        if screening is not None:
            most, tried = SCREENING.polished_for_best, len(screening.atoms)
            additions = screening.additions(current.effects, current.values, most)
            if additions and additions[0].is_sure(tried):
                return True
            uncovered = [c for c in uncovered if c.name not in screening.decided]
            uncovered = [c for c in uncovered if not acts_unshown(screening.balance, c.placed.effect)]
        names = {a.placed.name for a in additions[: SETTINGS.likeliest]} | {c.name for c in uncovered}
        self._told = self._sure_by_simulation(current, names, tried)
        return bool(self._told)

    def _sure_by_simulation(self, current: Fit, names: Set[str], tried: int) -> set[str]:
        """Of the candidates with these names those whose score test is beyond chance, of all and of so many `tried` by
        the balance: what adds up over seconds shows little in accelerations.
        """
        asked = [replace(c) for c in self._outside if c.name in names]
        Scores(self.models, current, self._step).score(asked)
        tried += sum(c.shapes_tried for c in asked)
        sizes = (len(c.placed.effect.parameters) - len(c.placed.effect.shapes) for c in asked)
        return {
            c.name
            for c, size in zip(asked, sizes, strict=True)
            if c.rejection is None and tried * chdtrc(max(size, 1), c.score.gain) < SETTINGS.by_chance
        }

    @property
    def _count(self) -> int:
        """How many effects are accepted: of the catalogue a law at several places counts once."""
        return len({a.placed.law for a in self.accepted})

    @property
    def _minor(self) -> list[Accepted]:
        """The last of the accepted effects, as far as they are minor."""
        return list(takewhile(lambda a: a.share < COMPARISON.minor, reversed(self.accepted)))

    def _without_minor(self, current: Fit) -> Fit:
        """`current` less the minor effects that came last, where they explain nothing after all."""
        minor = self._minor
        if self.models.is_explained(current) or (len(minor) == 1 and current.error <= LACK_OF_FIT.near_floor):
            return current
        for accepted in minor:
            without = self.models.without(current, accepted.name)
            if without is None:
                break
            self.accepted.remove(accepted)
            self._candidate(accepted.name).rejection = Rejection(Reason.MINOR, {"share": accepted.share})
            current = without
        return current

    def _split(self, current: Fit, newest: Sequence[Accepted]) -> Fit:
        """`current` with each of the `newest` effects that is at all places at once at each of them on its own, where
        that is clearly better, also than another effect in its place: filtered sensors look like controls that each
        come late.
        """
        for accepted in newest:
            if accepted.placed.effect.site != GLOBAL:
                continue
            # those among the candidates: at a sensor that is not in the log it would show nothing
            places = [
                c.placed
                for c in self._outside
                if c.placed.law == accepted.placed.law and c.placed.effect.site != GLOBAL
            ]
            if len(places) < 2:
                continue
            own = current.columns(accepted.name)
            rest = [e for e in current.effects if e.name != accepted.name]
            start = np.concatenate([np.delete(current.point, own), np.tile(current.point[own], len(places))])
            self._step("refit", 0, 1)
            fit = self.models.fit([*rest, *places], start, current)
            if fit is None or not self.models.is_better(current, fit):
                continue
            everywhere = self._candidate(accepted.name)
            self._ask_for_rivals(current, accepted)
            current = self._compare_with_rivals(current, [accepted])
            if accepted.name != everywhere.name and not self.models.is_better(current, fit):
                continue
            current = fit
            self.accepted.remove(accepted)
            everywhere.rejection = Rejection(Reason.BETTER_APART)
            share = accepted.share / len(places)
            for place in places:
                candidate = self._candidate(place.name)
                candidate.rejection = None
                self.accepted.append(
                    replace(accepted, placed=place, score=candidate.score, rivals=[], share=share)
                )
        return current

    def _step(self, what: str, number: int, total: int) -> None:
        self.on_step(what, number, total, [a.placed for a in self.accepted])

    @property
    def _outside(self) -> list[Candidate]:
        """Candidates that are not accepted."""
        inside = {a.name for a in self.accepted}
        return [c for c in self.candidates if c.name not in inside]

    def _next(self, current: Fit) -> Fit | None:
        """The model with what is accepted next; None where nothing is: what the force balance puts first, or what
        simulations tell of where that is better: these see friction on a body at rest, of which the balance has no
        derivative. They are not asked where the balance leaves too little for another to matter.
        """
        self.models.held = []
        if self._told:
            told = [c for c in self._outside if c.name in self._told]
            choice = ForwardRound(self.models, current, told, patient=False, on_step=self._step).choose()
            return None if choice is None else self._with(*choice, current)
        if steps := self._shorter_steps(current):
            return self._with(*steps, current)
        balance = self._balance_round(current)
        if balance is None:
            choice = self._by_simulation(current)
        else:
            choice = self._of_balance(balance)
            if self.models.is_explained(current):
                return None if choice is None else self._with(*choice, current)
            if choice is None or self._leaves_much(choice[0].fit, current):
                known = choice or self.accepted or self.given
                likeliest = [] if known else balance.ranked[: SETTINGS.likeliest]
                choice = self._better(choice, self._by_simulation(current, choice, likeliest))
        return None if choice is None else self._with(*choice, current)

    def _shorter_steps(self, current: Fit) -> Choice | None:
        """The model in shorter steps, where no more explains the log: what an integrator leaves out is no
        effect, and looks like several. Asked first, beside the best that the balance has, where simulations promise it.
        """
        asked = [c for c in self._outside if _is_shorter_step(c.placed)]
        if (
            not asked
            or any(_is_shorter_step(e) for e in current.effects)
            or self.models.is_explained(current)
        ):
            return None
        Scores(self.models, current, self._step).score(asked)
        _, at = thinned(self.models.fit_part, current)
        gain = max((c.score.gain for c in by_score(asked)), default=0.0)
        left = current.error**2 / (1 + gain / at.data.count) - 1
        if left > SETTINGS.left_by_steps * current.excess:
            return None
        screening = self.models.screening_about(current, self._step)
        if screening is not None:
            covered = [c for c in self._outside if c.name in screening.covered]
            score_in_balance(screening, current, covered)
            asked += by_score(covered)[: ROUND.rivals]
        choice = ForwardRound(self.models, current, asked, patient=False, on_step=self._step).choose()
        if choice is None or not self.models.is_explained(choice[0].fit):
            return None
        return choice if all(_is_shorter_step(e) for e in choice[0].added) else None

    def _leaves_much(self, fit: Fit, current: Fit) -> bool:
        return not self.models.is_explained(fit) and fit.excess > REJECTION.material * current.excess

    def _better(self, one: Choice | None, other: Choice | None) -> Choice | None:
        if one is None or other is None:
            return one or other
        return other if self.models.best_of([one[0], other[0]]) is other[0] else one

    def _balance_round(self, current: Fit) -> BalanceRound | None:
        screening = self.models.screening_about(current, self._step)
        if screening is None:
            return None
        return BalanceRound(
            self.models,
            screening,
            current,
            [c for c in self._outside if c.name in screening.covered],
            most=self.most_effects - self._count,
            on_step=self._step,
        )

    def _of_balance(self, balance: BalanceRound) -> Choice | None:
        """What the balance found and simulations bear out, with its rivals."""
        choice = balance.choose()
        if choice is None:
            return None
        for candidate in self._outside:
            if candidate.name not in balance.candidates:
                candidate.rejection = NOT_ASKED
        return choice

    def _with(self, chosen: FittedSet, rivals: list[Candidate], current: Fit) -> Fit:
        """The model `chosen`, its effects accepted."""
        share = (current.excess - chosen.fit.excess) / self.models.excess / len(chosen.added)
        for placed in chosen.added:
            candidate = self._candidate(placed.name)
            candidate.rejection = None
            self.accepted.append(Accepted(placed, candidate.score, rivals, chosen.support, share))
        return chosen.fit

    def _by_simulation(
        self, current: Fit, rival: Choice | None = None, likeliest: Sequence[Candidate] = ()
    ) -> Choice | None:
        """The best of what simulations alone tell of, with its rivals; of everything, where nothing else was found.
        rival: what the balance found; likeliest: what it puts first, where no simulation bears that out.
        """
        for asked, patient in self._asked_of_simulations(current, rival, likeliest):
            found = ForwardRound(
                self.models, current, asked, patient=patient, rival=rival and rival[0].fit, on_step=self._step
            )
            for candidate in asked:
                gain = candidate.score.gain if candidate.score else 0.0
                # where it diverged, or has nothing to act on, as hard friction where there is none, it tells nothing
                gain = gain if gain > SETTINGS.acts else np.inf
                self._promised[candidate.name] = gain * current.error**2 / found.scored.at.data.count
            choice = found.choose()
            if choice is not None:
                return choice
        return None

    def _asked_of_simulations(
        self, current: Fit, rival: Choice | None, likeliest: Sequence[Candidate]
    ) -> Iterator[tuple[list[Candidate], bool]]:
        """What simulations are asked of, and whether patiently, until they find something: what the balance does not
        cover, and the `likeliest` of what it does; then, where nothing was found that the declared model lacks,
        everything.
        """
        screening = self.models.screening(self._step)
        covered = frozenset() if screening is None else screening.decided - {c.name for c in likeliest}
        first = not (self.accepted or rival)
        if covered or not first:
            asked = self._asked_again([c for c in self._outside if c.name not in covered], current)
            if asked:
                yield asked, False
        if first and not (self.given and covered):
            yield self._outside, True

    def _asked_again(self, candidates: Sequence[Candidate], current: Fit) -> list[Candidate]:
        """Those of the candidates whose last score, beside fewer effects, was not far below what a fit takes now; of
        the others it is said why they are out. One effect more may leave less to explain, and seldom leaves more for
        another that it has nothing to do with.
        """
        takes = SETTINGS.asked_again * FORWARD_ROUND.promised * REJECTION.material * current.excess
        little = [c for c in candidates if self._promised.get(c.name, np.inf) < takes]
        for candidate in little:
            candidate.rejection = Rejection(Reason.PROMISED_LITTLE)
        return [c for c in candidates if self._promised.get(c.name, np.inf) >= takes]

    # --- backward ---

    def _backward(self, current: Fit) -> Fit:
        """Drop the effects that nothing speaks for, given the others: as many at once, weakest first, as nothing speaks
        for together.
        """
        while True:
            idle = self._idle(current)
            if not idle:
                return current
            current = self._dropped(current, idle)

    def _idle(self, current: Fit) -> list[tuple[Accepted, Fit]]:
        """The effects that nothing speaks for, weakest first, each with the model without it."""
        idle = []
        for number, accepted in enumerate(self.accepted):
            self._step("drop", number, len(self.accepted))
            fit = self.models.without(current, accepted.name)
            if fit is None:
                continue
            if current.at.data.rough:  # with the effect a descent may have left a poor minimum
                fit = self.models.better_from(fit, current) or fit
            accepted.support, _ = self._support(fit, current, [accepted])
            if accepted.support.reason_against():
                idle.append((accepted, fit))
        return sorted(idle, key=lambda own: own[0].support.bic_gain)

    def _dropped(self, current: Fit, idle: Sequence[tuple[Accepted, Fit]]) -> Fit:
        """`current` without the weakest of `idle`: half as many each time that something speaks for them together, for
        of two that do the same each alone has nothing to do.
        """
        count, (_, left) = len(idle), idle[0]
        while count > 1:
            some = [accepted for accepted, _ in idle[:count]]
            self._step("drop", 0, 1)
            without = self.models.without(current, *(a.name for a in some))
            if without is not None and self._support(without, current, some)[0].reason_against():
                left = without
                break
            count //= 2
        for accepted, _ in idle[:count]:
            self.accepted.remove(accepted)
            self._candidate(accepted.name).rejection = accepted.support.reason_against().with_others()
        return left

    def _support(
        self, without: Fit, fit: Fit, some: Sequence[Accepted | Candidate]
    ) -> tuple[Support, PartFit | None]:
        """The support for `some` effects in `fit` over the model `without` them, each the best of all candidates, and
        how `fit` does on what judges.
        """
        return self.models.support(
            without, fit, [self._candidate(a.name) for a in some], len(self.candidates)
        )

    def _candidate(self, name: str) -> Candidate:
        return next(c for c in self.candidates if c.name == name)

    # --- ties ---

    def _ask_again(self, current: Fit) -> None:
        """Rivals of accepted effects, by what the model without it leaves with the others in.

        What spoke for one while others were missing may have been theirs. The last that came was asked then, among what
        was as good as the best: it need not have been that, where that is what no simulation can do. So it is asked
        again where it explains the log. Of a law at several places one place is asked. What explains the log in its
        place is a rival whatever the balance says.
        """
        asked: set[tuple[str, str]] = set()
        explained = self.models.is_explained(current)
        for number, accepted in enumerate(self.accepted):
            if accepted.placed.law in asked:
                continue
            asked.add(accepted.placed.law)
            self._step("rivals", number, len(self.accepted))
            if explained or accepted is not self.accepted[-1] or not accepted.rivals:
                self._ask_for_rivals(current, accepted)
            if explained:
                self._ask_simulations_for_rivals(current, accepted)

    def _ask_for_rivals(self, current: Fit, accepted: Accepted) -> None:
        """Those of one accepted effect, by what the model without it leaves."""
        without = self.models.without(current, accepted.name)
        screening = self.models.screening_about(current, self._step)
        by_simulation = screening is None or self._contradicts_balance(current)
        if without is None or not (by_simulation or accepted.name in screening.covered):
            return
        inside = {a.name for a in self.accepted} - {accepted.name}
        candidates = [replace(c) for c in self.candidates if c.name not in inside]
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
            new = new[: SETTINGS.likeliest]
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
            for c in self.candidates
            if c.placed.effect.place == other_end and _numbers(c.placed) == same
        ]

    def _ask_simulations_for_rivals(self, current: Fit, accepted: Accepted) -> None:
        """Those of an effect that the balance found, among what simulations alone tell of, scored beside it by these:
        soft friction and friction that holds at first like a spring do the same.
        """
        without, screening = self.models.without(current, accepted.name), self.models.screening(self._step)
        if without is None or screening is None or accepted.name not in screening.covered:
            return
        mine = replace(self._candidate(accepted.name))
        asked = {r.name for r in accepted.rivals} | screening.decided
        others = [replace(c) for c in self._outside if c.name not in asked]
        Scores(self.models, without, self._step).score([mine, *others])
        ranked = by_score(others)
        # near null these may see little of what the balance found, whose own score is no measure of others then
        most = max(
            (c for c in (mine, *ranked[:1]) if c.score is not None), key=lambda c: c.score.gain, default=mine
        )
        explaining = self.models.explaining_with({a.name for a in self.accepted} - {accepted.name})
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
            own = self._candidate(candidate.name)
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
        screening = self.models.screening_about(moved, self._step, moved=moved is not fitted)
        if screening is None or by_simulation:
            Scores(self.models, fitted, self._step).score(candidates)
            return by_score(candidates)
        candidates = [c for c in candidates if c.name in screening.covered]
        score_in_balance(screening, moved, candidates, polished)
        return by_score(candidates)

    def _contradicts_balance(self, current: Fit) -> bool:
        """Whether simulations of the model explain the log, and the force balance does not: between commands that are
        held for long a joint moves as its rows do not show.
        """
        screening = self.models.screening_about(current, self._step)
        if screening is None or not self.models.is_explained(current):
            return False
        declared = current.point[: len(self.models.fits.prepared.task.space)]
        model = BalancedModel(tuple(current.effects), declared, tuple(current.values))
        return screening.fits.judged(model).beyond_noise > SETTINGS.contradicts

    def _compare_with_rivals(self, current: Fit, some: Sequence[Accepted]) -> Fit:
        """Put rivals of `some` accepted effects in their places: swap where one is better, tie where none can tell."""
        for accepted in some:
            inside = {a.name for a in self.accepted}
            accepted.tied, others = [], []
            for number, rival in enumerate(r for r in accepted.rivals if r.name not in inside):
                self._step("compare", number, len(accepted.rivals))
                other = self._swapped(current, accepted, rival)
                if other is not None:
                    others.append(other)
            best, others = self.models.best(self._candidate_of(current, accepted), others)
            best, others = self.models.best(best, [self._again_from(best, other) for other in others])
            for other in others:
                reason = self._why_no_better(best, other)
                self._candidate(other.name).rejection = Rejection(reason, {"best": best.name})
                if reason == Reason.TIED:
                    accepted.tied.append(other)
            if best.name != accepted.name:
                self._candidate(best.name).rejection = None
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
        support, select = self._support(without, fit, [candidate])
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


def _is_shorter_step(placed: Placed) -> bool:
    """Whether it is the model's motion in shorter steps."""
    return placed.effect.substeps > 1 and not placed.effect.parameters


def _are_steps(one: Placed, other: Placed) -> bool:
    """Whether both are, of two lengths: no experiment would tell them apart."""
    return one.kind == other.kind and _is_shorter_step(one)
