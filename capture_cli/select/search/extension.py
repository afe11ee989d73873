"""What may be added next: the best sets of the force balance, or what simulations alone tell of."""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from capture_cli.common.frozen import frozen
from capture_cli.estimate.balance.dictionary import acts_unshown
from capture_cli.estimate.balance.screening import SETTINGS as SCREENING
from capture_cli.estimate.fit import Fit, thinned
from capture_cli.select.balance_scores import score_in_balance
from capture_cli.select.candidates import Candidate
from capture_cli.select.fit_checks import SETTINGS as FIT_CHECKS
from capture_cli.select.reason import Reason, Rejection
from capture_cli.select.search.answer import SETTINGS as ANSWER
from capture_cli.select.search.answer import Answer
from capture_cli.select.search.balance_round import BalanceRound
from capture_cli.select.search.forward_round import SETTINGS as FORWARD_ROUND
from capture_cli.select.search.forward_round import ForwardRound, Scores
from capture_cli.select.search.round import SETTINGS as ROUND
from capture_cli.select.search.round import Choice, by_score


@frozen
class SETTINGS:
    # how often the score test may take the best of all candidates for an effect where nothing is missing
    by_chance: float = 0.01
    # of the score that a fit takes now: what simulations alone tell of is scored again where its last score was that
    asked_again: float = 0.5
    # of the squared error above the noise floor, what shorter steps may leave by their score, to be asked first
    left_by_steps: float = 0.5
    # gain of a score: less than chance gives whatever acts, but once in a thousand times
    acts: float = 1e-6
    # of the noise floor: what is left of a log without noise is the solver's rounding, in which anything is significant
    rounding: float = 0.01


NOT_ASKED = Rejection(Reason.NOT_ASKED)


class Extension:
    """Looks for what may be added to a model. most: effects, as of `Attribution`; given: whether the candidates are
    some of the catalogue.
    """

    def __init__(self, answer: Answer, *, most: int, given: bool):
        self.answer, self.models = answer, answer.models
        self.most, self.given = most, given
        self._told: set[str] = set()  # of an explained log, what simulations alone are sure of
        self._promised: dict[str, float] = {}  # by its last score through the simulator, squared noise floors

    @property
    def room(self) -> int:
        """How many more effects may be added."""
        return self.most - self.answer.count

    def is_missing(self, current: Fit) -> bool:
        """Whether more is left than chance allows; or, of the declared model, an effect predicts blocks that no fit saw
        so much better that chance does not, or has a score test that is beyond it: parameters that stand in for it may
        leave next to nothing. What an effect that was found leaves of so little would be corrected, not explained.
        """
        self._told = set()
        explained = self.models.is_explained(current)
        if self.answer.accepted or not explained:
            return not explained
        if current.error < SETTINGS.rounding:
            return False
        screening = self.models.screening_about(current, self.answer.step)
        additions, tried, uncovered = [], 0, self.answer.outside
        if screening is not None:
            most, tried = SCREENING.polished_for_best, len(screening.atoms)
            additions = screening.additions(current.effects, current.values, most)
            if additions and additions[0].is_sure(tried):
                return True
            uncovered = [c for c in uncovered if c.name not in screening.decided]
            uncovered = [c for c in uncovered if not acts_unshown(screening.balance, c.placed.effect)]
        names = {a.placed.name for a in additions[: ANSWER.likeliest]} | {c.name for c in uncovered}
        self._told = self._sure_by_simulation(current, names, tried)
        return bool(self._told)

    def _sure_by_simulation(self, current: Fit, names: Set[str], tried: int) -> set[str]:
        """Of the candidates with these names those whose score test is beyond chance, of all and of so many `tried` by
        the balance: what adds up over seconds shows little in accelerations.
        """
        asked = [replace(c) for c in self.answer.outside if c.name in names]
        Scores(self.models, current, self.answer.step).score(asked)
        tried += sum(c.shapes_tried for c in asked)
        sizes = (len(c.placed.effect.parameters) - len(c.placed.effect.shapes) for c in asked)
        return {
            c.name
            for c, size in zip(asked, sizes, strict=True)
            if c.rejection is None and tried * chdtrc(max(size, 1), c.score.gain) < SETTINGS.by_chance
        }

    def next(self, current: Fit) -> Fit | None:
        """The model with what is accepted next; None where nothing is: what the force balance puts first, or what
        simulations tell of where that is better: these see friction on a body at rest, of which the balance has no
        derivative. They are not asked where the balance leaves too little for another to matter.
        """
        self.models.held = []
        if self._told:
            told = [c for c in self.answer.outside if c.name in self._told]
            choice = ForwardRound(
                self.models, current, told, patient=False, on_step=self.answer.step
            ).choose()
            return None if choice is None else self.answer.accept(*choice, current)
        if steps := self._shorter_steps(current):
            return self.answer.accept(*steps, current)
        balance = self._balance_round(current)
        if balance is None:
            choice = self._by_simulation(current)
        else:
            choice = self._of_balance(balance)
            if self.models.is_explained(current):
                return None if choice is None else self.answer.accept(*choice, current)
            if choice is None or self._leaves_much(choice[0].fit, current):
                known = choice or self.answer.accepted or self.given
                likeliest = [] if known else balance.ranked[: ANSWER.likeliest]
                choice = self._better(choice, self._by_simulation(current, choice, likeliest))
        return None if choice is None else self.answer.accept(*choice, current)

    def _shorter_steps(self, current: Fit) -> Choice | None:
        """The model in shorter steps, where no more explains the log: what an integrator leaves out is no
        effect, and looks like several. Asked first, beside the best that the balance has, where simulations promise it.
        """
        asked = [c for c in self.answer.outside if c.placed.is_shorter_step]
        if not asked or self.models.is_explained(current):
            return None
        Scores(self.models, current, self.answer.step).score(asked)
        _, at = thinned(self.models.fit_part, current)
        gain = max((c.score.gain for c in by_score(asked)), default=0.0)
        left = current.error**2 / (1 + gain / at.data.count) - 1
        if left > SETTINGS.left_by_steps * current.excess:
            return None
        screening = self.models.screening_about(current, self.answer.step)
        if screening is not None:
            covered = [c for c in self.answer.outside if c.name in screening.covered]
            score_in_balance(screening, current, covered)
            asked += by_score(covered)[: ROUND.rivals]
        choice = ForwardRound(self.models, current, asked, patient=False, on_step=self.answer.step).choose()
        if choice is None or not self.models.is_explained(choice[0].fit):
            return None
        return choice if all(e.is_shorter_step for e in choice[0].added) else None

    def _leaves_much(self, fit: Fit, current: Fit) -> bool:
        return not self.models.is_explained(fit) and fit.excess > FIT_CHECKS.material * current.excess

    def _better(self, one: Choice | None, other: Choice | None) -> Choice | None:
        if one is None or other is None:
            return one or other
        return other if self.models.best_of([one[0], other[0]]) is other[0] else one

    def _balance_round(self, current: Fit) -> BalanceRound | None:
        screening = self.models.screening_about(current, self.answer.step)
        if screening is None:
            return None
        return BalanceRound(
            self.models,
            screening,
            current,
            [c for c in self.answer.outside if c.name in screening.covered],
            most=self.room,
            on_step=self.answer.step,
        )

    def _of_balance(self, balance: BalanceRound) -> Choice | None:
        """What the balance found and simulations bear out, with its rivals."""
        choice = balance.choose()
        if choice is None:
            return None
        for candidate in self.answer.outside:
            if candidate.name not in balance.candidates:
                candidate.rejection = NOT_ASKED
        return choice

    def _by_simulation(
        self, current: Fit, rival: Choice | None = None, likeliest: Sequence[Candidate] = ()
    ) -> Choice | None:
        """The best of what simulations alone tell of, with its rivals; of everything, where nothing else was found.
        rival: what the balance found; likeliest: what it puts first, where no simulation bears that out.
        """
        for asked, patient in self._asked_of_simulations(current, rival, likeliest):
            found = ForwardRound(
                self.models,
                current,
                asked,
                patient=patient,
                rival=rival and rival[0].fit,
                on_step=self.answer.step,
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
        screening = self.models.screening(self.answer.step)
        covered = frozenset() if screening is None else screening.decided - {c.name for c in likeliest}
        first = not (self.answer.accepted or rival)
        if covered or not first:
            asked = self._asked_again([c for c in self.answer.outside if c.name not in covered], current)
            if asked:
                yield asked, False
        if first and not (self.given and covered):
            yield self.answer.outside, True

    def _asked_again(self, candidates: Sequence[Candidate], current: Fit) -> list[Candidate]:
        """Those of the candidates whose last score, beside fewer effects, was not far below what a fit takes now; of
        the others it is said why they are out. One effect more may leave less to explain, and seldom leaves more for
        another that it has nothing to do with.
        """
        takes = SETTINGS.asked_again * FORWARD_ROUND.promised * FIT_CHECKS.material * current.excess
        little = [c for c in candidates if self._promised.get(c.name, np.inf) < takes]
        for candidate in little:
            candidate.rejection = Rejection(Reason.PROMISED_LITTLE)
        return [c for c in candidates if self._promised.get(c.name, np.inf) >= takes]
