"""One round of the search where the log gives a force balance: the best sets of effects there, fitted by simulation."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from capture_cli.estimate.balance.balanced_model import BalancedModel
from capture_cli.estimate.balance.screening import Screening
from capture_cli.estimate.fit import Fit, least
from capture_cli.estimate.model_fits import Effort
from capture_cli.estimate.noise.lack_of_fit import lack_of_fit
from capture_cli.model.effects.placed import Placed, names_of
from capture_cli.select.balance_scores import score_in_balance
from capture_cli.select.candidates import Candidate
from capture_cli.select.fit_checks import SETTINGS as FIT_CHECKS
from capture_cli.select.fit_checks import (
    ends,
    leaves_something,
    needed_error,
    no_gain,
    slight,
)
from capture_cli.select.model_comparison import FittedSet, ModelComparison
from capture_cli.select.reason import Reason, Rejection
from capture_cli.select.search.beam import SETTINGS as BEAM
from capture_cli.select.search.beam import Level, grown
from capture_cli.select.search.round import Round, by_score

# of a fit whose effects are at ends of their ranges: which effects, at which ends, and what that says
AtEnds = tuple[frozenset[str], frozenset, Rejection]


class BalanceRound(Round):
    """What may be added to the model `current`, of the candidates that the screening covers.

    most: effects, or laws at all of their places, to add.
    """

    def __init__(
        self,
        models: ModelComparison,
        screening: Screening,
        current: Fit,
        candidates: Sequence[Candidate],
        *,
        most: int,
        on_step: Callable[[str, int, int], None],
    ):
        super().__init__(models, current, candidates, on_step=on_step)
        score_in_balance(screening, current, candidates)
        self.ranked = by_score(candidates)
        self._at_ends: list[AtEnds] = []
        # beside what was found already one is looked for at a time
        sizes = 1 if current.effects else most
        self.supported = self._search(grown(screening, current.effects, current.values, sizes), sizes)

    def _search(self, levels: Iterator[Level], sizes: int) -> list[FittedSet]:
        """Those of the models that hold on what judges, fitted by simulation: of each size those that are as good as
        the best in the balance, until one leaves nothing; then larger sets of what holds. sizes: how many there may be.
        """
        found: list[FittedSet] = []
        smaller, singles = self.current, []
        for number, level in enumerate(levels):
            larger = number > 0
            singles = singles or level.others
            if larger:
                smaller = least([s.fit for s in found]) or self.current
            more = self._best_that_hold(level, smaller)
            found += more
            if (larger and not more) or self._explained(found):
                break
            self.on_step("set size", min(number + 1, sizes - 1), sizes)
        if self._explained(found):
            return [*found, *self._simpler(singles, found)]
        return self._with_unions(found)

    def _simpler(self, singles: Sequence[BalancedModel], found: Sequence[FittedSet]) -> list[FittedSet]:
        """Those of `singles`, effects that the balance puts behind, that explain the log with fewer parameters than all
        of what was found: where an effect is large, the balance, which is linear in small ones, prefers what bends.
        """
        fewest = min(len(s.fit.point) for s in found if self.models.is_explained(s.fit))
        simpler = [m for m in singles if len(m.start) < fewest and not self.models.is_fitted(m.effects)]
        return self._fit(simpler, self.current, to_explain=True)

    def _best_that_hold(self, level: Level, smaller: Fit) -> list[FittedSet]:
        """As good as the best in the balance. Where simulations bear out none of them, and nothing was found yet, as
        good as the best of the others, and so on: the balance may prefer what no simulation can do.
        """
        found = self._fit(level.as_good, smaller)
        while not (found or self.current.effects) and (level := level.behind(BEAM)):
            found = self._fit(level.as_good, smaller)
        return found

    def _with_unions(self, found: list[FittedSet]) -> list[FittedSet]:
        """`found`, and larger sets of it where it leaves something."""
        if not found or self._explained(found):
            return found
        return [*found, *self._fit(self._unions(found), least([s.fit for s in found]), to_explain=True)]

    def _explained(self, found: Sequence[FittedSet]) -> bool:
        return any(self.models.is_explained(s.fit) for s in found)

    def _fit(
        self, models: Sequence[BalancedModel], smaller: Fit, *, to_explain: bool = False
    ) -> list[FittedSet]:
        """Those that hold. Fits with hidden states take long: they come last, and are stopped early where they stay far
        behind.

        to_explain: whether they have to leave nothing; one law at several places has not.
        """
        found = []
        for number, model in enumerate(sorted(models, key=_hidden_states)):
            simpler = [s for s in found if len(s.fit.point) < len(model.start)]
            if _hidden_states(model) and self._explained(simpler):
                break  # with more parameters it could but do as well
            self.on_step("refit", number, len(models))
            found += self._fitted(model, smaller, to_explain)
        if self._explained(found):
            found = self._again_from(least([s.fit for s in found]), found, models, to_explain)
        return found

    def _again_from(
        self, best: Fit, found: list[FittedSet], models: Sequence[BalancedModel], to_explain: bool
    ) -> list[FittedSet]:
        """`found`, and those of the models that left something, but do not from where the `best` declared one is."""
        declared = best.point[: len(self.models.fits.prepared.task.space)]
        for model in models:
            known = next((s for s in found if s.added == model.effects[len(self.current.effects) :]), None)
            if known is not None and self.models.is_explained(known.fit):
                continue
            start = np.concatenate([declared, *model.values])
            if self.models.explained_from(start, model.effects, best) is not None:
                found = [s for s in found if s is not known] + self._fitted(model, self.current, to_explain)
        return found

    def _unions(self, found: Sequence[FittedSet]) -> list[BalancedModel]:
        """The best of the models `found` with each of the best single effects beside it: what holds in simulations the
        balance need not prefer.
        """
        ranked = sorted(found, key=lambda s: s.fit.penalised_squares)
        (best, *_), known = ranked, {names_of(s.fit.effects) for s in found}
        unions, declared = [], len(self.models.fits.prepared.task.space)
        for other in [s for s in ranked if len(s.added) == 1 and s.added[0] not in best.added][: BEAM.united]:
            effects = (*best.fit.effects, *other.added)
            if names_of(effects) in known:
                continue
            values = [*best.fit.values, other.fit.point[other.fit.columns(other.added[0].name)]]
            unions.append(BalancedModel(effects, best.fit.point[:declared], tuple(values)))
        return unions

    def _fitted(self, model: BalancedModel, smaller: Fit, to_explain: bool) -> list[FittedSet]:
        """The model fitted by simulation, if it holds on what judges and explains materially more than `smaller`.

        Laws that each hold alone have to leave nothing together: they may stand in for one that the balance of the
        `current` model, which is far from the machine, does not show. The best of them moves it nearer.
        """
        added = model.effects[len(self.current.effects) :]
        is_known = self.models.is_fitted(model.effects)
        reason = None if is_known else _ended(model, len(self.current.effects), self._at_ends)
        if reason:
            self._reject(added, reason)
            return []
        rival, to_explain = self._best, to_explain and (len(added) == 1 or not _is_one_law(added))
        to_reach = lack_of_fit(self.current.at).threshold if to_explain else np.inf
        material = needed_error(smaller, FIT_CHECKS.material)
        needed = min(material, self.useful_error, to_reach)
        effort = Effort(rival=rival, to_reach=to_reach, needed=needed, material=material, escapes=False)
        fit = self.models.fit(model.effects, model.start, self.current, effort)
        reason, found = self._unfit(fit, added, smaller, to_explain), None
        if not reason:
            reason, found = self._judged(added, fit)
        if found is not None:
            reason = self._left(found.fit, to_explain)
        self._best = least([rival, fit if found is None else found.fit])
        if reason:
            self._reject(added, reason)
            return []
        self.models.held.append(found)
        return [found]

    def _left(self, fit: Fit, to_explain: bool) -> Rejection | None:
        """What is said against a model by what its fit leaves. to_explain: whether that has to be nothing."""
        reason = leaves_something(self.current, fit, self.useful_error)
        if not reason and to_explain and not self.models.is_explained(fit):
            reason = Rejection(Reason.LEAVES_SOMETHING, {"after": fit.error})
        return reason

    def _unfit(
        self, fit: Fit | None, added: Sequence[Placed], smaller: Fit, to_explain: bool
    ) -> Rejection | None:
        """What its fit says against a model."""
        models, current = self.models, self.current
        reason = no_gain(current, fit, self._best) or slight(smaller, fit, FIT_CHECKS.material)
        if not (reason or models.may_escape(fit, self._best, self.useful_error)):
            reason = self._left(fit, to_explain)
        if reason:
            return reason
        reason = self._out_of_range(added, fit)
        if reason:
            values = [fit.point[fit.columns(e.name)] for e in added]
            self._at_ends.append((names_of(added), _ends(added, values), reason))
        return reason


def _is_one_law(added: Sequence[Placed]) -> bool:
    """Whether the effects are one law, at one place or several."""
    return len({e.law for e in added}) == 1


def _ended(model: BalancedModel, known: int, at_ends: Sequence[AtEnds]) -> Rejection | None:
    """What the fit of some of the effects that come after the `known` said: that one of them has to be at the end of
    its range, if the balance has it there, too, and leaves more than the sensors' noise. Where nothing is left that
    says little.
    """
    if model.beyond_noise < 1:
        return None
    added = model.effects[known:]
    names, there = names_of(added), _ends(added, model.values[known:])
    return next((why for some, at, why in at_ends if some < names and at and at <= there), None)


def _ends(effects: Sequence[Placed], values: Sequence[np.ndarray]) -> frozenset:
    """Which parameters of the effects are at which ends of their ranges."""
    return frozenset((e.name, *end) for e, v in zip(effects, values, strict=True) for end in ends(e, v))


def _hidden_states(model: BalancedModel) -> int:
    return sum(len(e.states) for _, e in model.effects)
