"""Which effects? Ask the force balance for the best sets of them, fit those, accept what holds; then put each to test.

Where a log gives no balance, or where none of what the balance covers explains it, effects are scored one at a time by
simulations (`forward_round`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from capture_cli.errors import OutOfTime
from capture_cli.estimate.balance.regression import SETTINGS as REGRESSION
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.model.effects.placed import Placed, names_of
from capture_cli.select.candidates import Candidate, all_candidates
from capture_cli.select.fit_checks import SETTINGS as FIT_CHECKS
from capture_cli.select.fit_checks import slight
from capture_cli.select.log_parts import Folds
from capture_cli.select.model_comparison import ModelComparison
from capture_cli.select.reason import Reason, Rejection
from capture_cli.select.search.answer import SETTINGS as ANSWER
from capture_cli.select.search.answer import Answer
from capture_cli.select.search.apart import split
from capture_cli.select.search.extension import Extension
from capture_cli.select.search.removal import backward, without_minor
from capture_cli.select.search.rivals import Rivals


class Attribution:
    """Selection of effects: forward, backward, and against rivals.

    folds: what is fitted, and what judges; nothing judges where the log is one window long. most_effects: to add; a law
    at several places counts once. candidates: the whole catalogue where None; others are scored by simulations. on_step
    is told what is being tried, the number of it, of how many, and what was found so far; where it raises OutOfTime,
    the search ends with the last model that was whole.

    answer: what was found. out_of_time: whether it ended so.
    """

    def __init__(
        self,
        fits: ModelFits,
        folds: Folds,
        *,
        seed: int,
        most_effects: int = ANSWER.most_effects,
        candidates: Sequence[Candidate] | None = None,
        on_step: Callable[[str, int, int, Sequence[Placed]], None] = lambda *_: None,
    ):
        self.models = ModelComparison(fits, folds, seed=seed)
        self.models.candidates = all_candidates(fits.prepared) if candidates is None else list(candidates)
        self.answer = Answer(self.models, on_step)
        self.extension = Extension(self.answer, most=most_effects, given=candidates is not None)
        self.rivals = Rivals(self.answer)
        self._extended: set[frozenset[str]] = set()  # models, by their effects, that something was added to
        self.out_of_time = False

    def run(self, declared: Fit) -> Fit:
        """Add effects to the declared model until none is accepted or nothing is left; returns the last model."""
        self._keep(declared)
        try:
            return self._search(declared)
        except OutOfTime:
            self.out_of_time = True
            last, self.answer.accepted = self._whole
            last = self._with_what_holds(last)
            inside = {a.name for a in self.answer.accepted}
            for candidate in self.answer.candidates:
                if candidate.name not in inside and candidate.rejection is None:
                    candidate.rejection = Rejection(Reason.OUT_OF_TIME)
            return last

    def _with_what_holds(self, last: Fit) -> Fit:
        """`last`, with the best of what held in the round that was cut short. Nothing is simulated."""
        held = self.models.held
        return self.answer.accept(self.models.best_of(held), [], last) if held else last

    def _keep(self, current: Fit) -> Fit:
        """Take note of a model that is whole, and the effects in it; what held in its round is settled with it."""
        self.models.held = []
        self._whole = current, [replace(a, tied=list(a.tied)) for a in self.answer.accepted]
        return current

    def _search(self, declared: Fit) -> Fit:
        """Where a rival in the place of an effect explains materially more, the search goes on from there; where it
        explains the log, with the rivals of that one.
        """
        self.models.know(declared)
        current, explaining = declared, set()
        while True:
            extended = without_minor(self.answer, self._with_more(current))
            current = self._keep(backward(self.answer, extended))
            if current is not extended and not self.models.is_explained(current):
                continue  # what was dropped may have stood in for another
            self.rivals.ask(current)
            compared = self.rivals.compare(current, self.answer.accepted)
            if compared is current:
                return self._keep(current)
            explaining.add(names_of(current.effects))
            # with another in its place an effect may have nothing left to do
            before, current = current, backward(self.answer, compared)
            self._keep(current)
            if self.models.is_explained(current):
                if names_of(current.effects) in explaining:
                    return current
            elif slight(before, current, FIT_CHECKS.material):
                return current

    def _with_more(self, current: Fit) -> Fit:
        """The model with what can be added to it."""
        while self._may_extend(current):
            known = len(self.answer.accepted)
            if not known:
                self.models.excess = max(current.excess, REGRESSION.tiny)
            self._extended.add(names_of(current.effects))
            found = self.extension.next(current)
            if found is None:
                break
            current = self._keep(split(self.rivals, found, self.answer.accepted[known:]))
        return current

    def _may_extend(self, current: Fit) -> bool:
        new = names_of(current.effects) not in self._extended
        return new and self.extension.room > 0 and self.extension.is_missing(current)
