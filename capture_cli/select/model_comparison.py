"""Models with effects against each other: each fitted once, judged on what it was not fitted to, and compared."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.similarity import similarity
from capture_cli.errors import LogError
from capture_cli.estimate.balance.regression import SETTINGS as REGRESSION
from capture_cli.estimate.balance.screening import Screening
from capture_cli.estimate.fit import Fit, least
from capture_cli.estimate.model_fits import USUAL, Effort, ModelFits, searched
from capture_cli.estimate.noise.autocorrelation import correlation_samples
from capture_cli.estimate.noise.lack_of_fit import SETTINGS as LACK_OF_FIT
from capture_cli.estimate.noise.lack_of_fit import lack_held_out, lack_of_fit
from capture_cli.estimate.part_fit import PartFit
from capture_cli.estimate.solve.least_squares import SETTINGS as LEAST_SQUARES
from capture_cli.model.effects.placed import Placed
from capture_cli.select.balance_scores import screening_of
from capture_cli.select.candidates import Candidate
from capture_cli.select.criterion import SETTINGS as CRITERION
from capture_cli.select.criterion import Support, bic_gain, paired_p_value, ratio_p_value
from capture_cli.select.log_parts import Folds
from capture_cli.select.reason import Reason


@frozen
class SETTINGS:
    again_rounds: int = 20  # in which a model without an effect is to get where it got with it
    indistinct: float = 0.05  # two models are tied where the paired test between them is not below this
    # of twice the log likelihood, two sd: of less no difference is made, however steady it is
    as_likely: float = 4.0
    clearly_better: float = 10.0  # of BIC: "very strong" (Kass & Raftery 1995)
    strong: float = 6.0  # of BIC, odds of 20 to 1: of less no winner is made, however steadily it comes
    # sd of what hidden states of windows take by chance, beyond its mean, which is not counted
    chance: float = 3.0
    as_plain: float = 1.0  # of BIC: by no more than this may what MuJoCo has itself be behind, to come first
    # cosine of two effects' responses beyond which no parameter value tells them apart
    same_response: float = 0.9999
    # beyond which an effect that has parameters more is tied, too, if it does no better: a lag of either order, a delay
    same_here: float = 0.999
    # Of what the declared model leaves above the noise floor: one that takes less is minor. A model that is wrong in a
    # way that no effect is takes any number of minor ones, so they stand only where with them nothing is left, or one
    # alone comes near the floor.
    minor: float = 0.05
    # of what the model before it leaves: one that takes so much is not minor, however much others took before
    most: float = 0.9


_NOT_MADE = object()


@dataclass(frozen=True)
class FittedSet:
    """A model with effects added at once, fitted by simulation; select: on what judges, None where nothing does.

    support: for all of them together. score: none, for several effects have one each.
    """

    added: tuple[Placed, ...]
    fit: Fit
    select: PartFit | None
    support: Support
    score: None = None


Compared = (
    Candidate | FittedSet
)  # what models are told apart by: their fits, and what those leave of what judges


class ModelComparison:
    """Models of one log, which differ in their effects.

    folds: what is fitted, and what judges; nothing judges where the log is one window long.

    excess: squared error above the noise floor of the declared model. held: what holds so far in the round under way.
    """

    def __init__(self, fits: ModelFits, folds: Folds, *, seed: int):
        self.fits = fits
        self.folds = folds
        self.fit_part = fits.prepared.part(folds.fit)
        self.seed = seed
        self.excess = REGRESSION.tiny
        self.held: list[FittedSet] = []
        self.candidates: Sequence[Candidate] = ()
        self._screening: Screening | object | None = _NOT_MADE
        self._about: tuple[Fit, Screening | None] | None = None
        self._fitted: dict[tuple[str, ...], Fit | None] = {}
        self._judged: dict[Fit, PartFit] = {}
        self._explained: dict[Fit, bool] = {}

    def is_explained(self, fit: Fit) -> bool:
        """Whether a model leaves nothing but noise of what it is fitted to, and of what judges."""
        if fit not in self._explained:
            self._explained[fit] = not lack_of_fit(fit.at).lacking and self._holds_on_what_judges(fit)
        return self._explained[fit]

    def _holds_on_what_judges(self, fit: Fit) -> bool:
        """As it is, or fitted to that, too: its parameters may be no better known than the first fit leaves them."""
        if len(self.folds.folds) != 1:
            return True  # all windows are fitted
        on = self.judge(fit)
        if not lack_held_out(on.data, on.residual).lacking:
            return True
        seen, [(_, judged)] = self.folds.seen, self.folds.folds
        both = self.fits.fit(
            self.fits.prepared.part(seen),
            fit.effects,
            fit.point,
            near=fit,
            corrections=initial_states_found(self.folds, fit.corrections, on.corrections)[seen],
            effort=Effort(seed=self.seed),
        )
        if both is None or lack_of_fit(both.at).lacking:
            return False
        own = PartFit.of(both.at).rows(judged[seen])
        return not lack_held_out(own.data, own.residual).lacking

    def useful_error(self, current: Fit) -> float:
        """The error above which a model with more than `current` is of no use: where that leaves so little that what
        comes next is minor, near the floor, or where most of that is taken.
        """
        if current.excess >= SETTINGS.minor * self.excess:
            return np.inf
        most_taken = float(np.sqrt(1 + (1 - SETTINGS.most) * current.excess))
        return max(LACK_OF_FIT.near_floor, lack_of_fit(current.at).threshold, most_taken)

    def screening_about(
        self, fit: Fit, on_step: Callable[[str, int, int], None], *, moved: bool = False
    ) -> Screening | None:
        """Of the `candidates` in the force balance of a model; None where there is none, or too little moves in it.

        moved: whether its parameters are not those that fill the balance of what the log holds without more effects.
        """
        declared = self.screening(on_step)
        if declared is None or not (fit.effects or moved):
            return declared
        if self._about is None or self._about[0] is not fit:
            point = fit.point[: len(self.fits.prepared.task.space)]
            try:
                about = declared.about(point, fit.effects, fit.values)
                self._about = fit, about.with_new_columns({"control", "measurement"}) if moved else about
            except LogError:
                self._about = fit, None
        return self._about[1]

    def screening(self, on_step: Callable[[str, int, int], None]) -> Screening | None:
        """Of the `candidates` in the force balance of the declared model, made once; None where there is none."""
        if self._screening is _NOT_MADE:
            prepared, threads = self.fits.prepared, self.fits.engine.threads
            known, asked = prepared.screening, [c.placed for c in self.candidates]
            if not asked:
                self._screening = None
            elif known is not None and [p.name for p in known.placed] == [p.name for p in asked]:
                self._screening = known
            else:
                self._screening = screening_of(
                    prepared, self.folds.balance, self.candidates, threads, on_step
                )
            if self._screening is not None:
                self._screening.fits.on_work = self.fits.engine.on_work
        return self._screening

    def know(self, fit: Fit) -> None:
        """Take `fit` for the one of its effects."""
        self._fitted[_key(fit.effects)] = fit

    def is_fitted(self, effects: Sequence[Placed]) -> bool:
        """Whether the model with these effects was fitted before."""
        return _key(effects) in self._fitted

    def fit(
        self,
        effects: Sequence[Placed],
        start: np.ndarray,
        near: Fit,
        effort: Effort = USUAL,
        elsewhere: Sequence[np.ndarray] = (),
    ) -> Fit | None:
        """The fit of the declared model with `effects`: made once, and taken up again where it was stopped early.

        near: another model's, whose windows' initial states it begins with, or that of the best model with some of the
        effects. elsewhere: other points to begin at where the fit from `start` (parameter,) leaves something.
        """
        key = _key(effects)
        made = self._fitted.get(key)
        if made is not None and not made.finished and not made.is_far_behind(effort.rival):
            start, near = made.point, made
            del self._fitted[key]
        if key not in self._fitted:
            near = least([near, *self.known_with_some(effects)]) if len(near.effects) < len(effects) else near
            self._fitted[key] = self._fit_from([start, *elsewhere], effects, near, effort)
        return self._fitted[key]

    def known_with_some(self, effects: Sequence[Placed]) -> list[Fit | None]:
        """The fits so far with some of the effects, and no others."""
        names = set(_key(effects))
        return [fit for key, fit in self._fitted.items() if names.issuperset(key)]

    def explaining_with(self, names: set[str]) -> set[str]:
        """Effects that explained the log with those called `names` and no others."""
        more = {key: set(key) - names for key in self._fitted if names < set(key)}
        known = {key: self._fitted[key] for key, others in more.items() if len(others) == 1}
        return {min(more[key]) for key, fit in known.items() if fit is not None and self.is_explained(fit)}

    def _fit_from(
        self, starts: Sequence[np.ndarray], effects: Sequence[Placed], near: Fit, effort: Effort
    ) -> Fit | None:
        """The best fit from `starts`, of which one is taken after the other until nothing is left."""
        found = None
        for start in starts:
            own = replace(effort, seed=self.seed, rival=least([found, effort.rival]))
            found = least([found, self.fits.fit(self.fit_part, effects, start, near=near, effort=own)])
            if found is None or not self.is_explained(found):
                found = least([found, self._eased(start, effects, near, own)])
            if found is not None and self.is_explained(found):
                break
        return found

    def _eased(self, start: np.ndarray, effects: Sequence[Placed], near: Fit, effort: Effort) -> Fit | None:
        """The fit from where that of effects not in `near` ends whose states are less bound to the log before; None
        where there are none, or that does not help either.
        """
        inside = {e.name for e in near.effects}
        eased = [
            e._replace(effect=e.effect.eased() or e.effect) if e.name not in inside else e for e in effects
        ]
        if all(a.effect is b.effect for a, b in zip(eased, effects, strict=True)):
            return None
        there = self.fits.fit(self.fit_part, eased, start, near=near, effort=effort)
        if there is None or there.error > effort.needed:
            return None
        return self.fits.fit(self.fit_part, effects, there.point, near=near, effort=effort)

    def escaped(self, fit: Fit, rival: Fit | None, useful_error: float) -> Fit:
        """`fit`, or where the escape from a minimum leads that hidden states make, taken for the one of its effects."""
        if not self.may_escape(fit, rival, useful_error):
            return fit
        effort = Effort(seed=self.seed, rival=rival)
        found = self.fits.escaped(self.fit_part, fit.effects, fit.point, near=fit, effort=effort)
        self.know(found)
        return found

    @staticmethod
    def may_escape(fit: Fit, rival: Fit | None, useful_error: float) -> bool:
        """Whether an escape is worth its time, which is longer than that of the fit: for what is not far above
        `useful_error`, and not behind its rival.
        """
        behind = rival is not None and fit.error > rival.error
        near = fit.error <= LEAST_SQUARES.hopeless * useful_error
        return near and not behind and bool(searched(fit.effects))

    def explained_from(self, start: np.ndarray, effects: Sequence[Placed], near: Fit) -> Fit | None:
        """The fit from `start` (parameter,), taken for the one of its effects, if it leaves nothing but noise."""
        threshold = lack_of_fit(near.at).threshold
        found = self._fit_from([start], effects, near, Effort(to_reach=threshold, needed=threshold))
        if found is None or not self.is_explained(found):
            return None
        self.know(found)
        return found

    def better_from(self, current: Fit, found: Fit) -> Fit | None:
        """A better fit of the `current` model, begun where `found` ended, which has more parameters: contacts make the
        error rough.
        """
        again = self.fits.fit(
            self.fit_part,
            current.effects,
            self.fits.as_near(found, current.effects, current.point),
            near=found,
            effort=Effort(rounds=SETTINGS.again_rounds, seed=self.seed),
        )
        if again is None:
            return None
        if gain_by_bic(current, again) < SETTINGS.clearly_better:
            return None
        self.know(again)
        return again

    def without(self, current: Fit, *names: str) -> Fit | None:
        """The fit of `current` less the effects that are called so there."""
        effects = [e for e in current.effects if e.name not in names]
        own = np.r_[tuple(current.columns(name) for name in names)]
        return self.fit(effects, np.delete(current.point, own), current)

    def nested(self, last: Fit, count: int) -> Fit:
        """The fit of the declared model with the first `count` effects of `last`."""
        effects = last.effects[:count]
        return self.fit(effects, last.point[: self.fits.parameter_count(effects)], last) or last

    # --- judged ---

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
                own = self.fits.fit(train, fit.effects, fit.point, effort=Effort(seed=self.seed)) or fit
                own = own.known_from(train.windows.first)
            parts.append(self.fits.on(self.fits.prepared.part(judged), own))
        return parts[0] if len(parts) == 1 else PartFit.concatenate(parts)

    def _paired(self, before: PartFit, after: PartFit) -> float:
        length = _block_length(after)
        return paired_p_value(before.blocks(length), after.blocks(length), self.seed)

    def support(
        self, without: Fit, fit: Fit, added: Sequence[Candidate], tried: int
    ) -> tuple[Support, PartFit | None]:
        """Support for the candidates `added` in `fit` over the model `without` them, each the best of so many `tried`,
        and how `fit` does on what judges. Nothing judges where the fit itself speaks against.
        """
        # to be there or not is a choice, too
        size = sum(max(len(c.placed.effect.parameters), 1) for c in added)
        hypotheses = float(np.prod([tried * c.shapes_tried for c in added], dtype=float))
        samples = effective_samples(fit)
        free = samples - len(fit.space)
        p_fit = ratio_p_value(without.penalised_squares, fit.penalised_squares, free, size, hypotheses)
        gain = bic_gain(without.penalised_squares, fit.penalised_squares, samples, size)
        of_fit = Support(p_fit, None, gain, None)
        if of_fit.reason_against():
            return of_fit, None
        before, after = self.judge(without), self.judge(fit)
        if after is None:
            return of_fit, None
        ratio = float(after.penalised_squares.sum() / before.penalised_squares.sum())
        return Support(p_fit, self._paired(before, after), gain, ratio), after

    # --- compared ---

    def as_good(self, best: Compared, other: Compared) -> bool:
        """Whether neither the fitted windows nor those that judge tell `other` from `best`; or it has parameters less,
        by which it is ahead of more than those that judge put it behind.
        """
        more, gain = self._more_and_gain(best, other)
        if more < 0 and self._whole(best, other) > SETTINGS.strong:
            return True
        return gain > -SETTINGS.clearly_better - chance(best.fit, other.fit) and self._indistinct(best, other)

    def best_of(self, some: Sequence[Compared]) -> Compared:
        """By BIC, and what judges."""
        first = some[0]
        return max(some, key=lambda other: self._whole(first, other))

    def is_better(self, fit: Fit, other: Fit) -> bool:
        """Whether the model `other` is clearly better than `fit` by BIC, and no worse on what judges."""
        if gain_by_bic(fit, other) < SETTINGS.clearly_better:
            return False
        before, after = self.judge(fit), self.judge(other)
        return after is None or after.penalised_squares.sum() <= before.penalised_squares.sum()

    def _whole(self, mine: Compared, other: Compared) -> float:
        """What `other` gains by BIC where both were fitted, and in twice the log likelihood of what judges, if any."""
        gain = self._more_and_gain(mine, other)[1]
        is_judged = mine.select is not None and other.select is not None
        return gain - self._behind(mine, other) if is_judged else gain

    def _more_and_gain(self, mine: Compared, other: Compared) -> tuple[int, float]:
        """How many parameters `other` has more than `mine`, and what its fit gains by BIC."""
        return len(other.fit.point) - len(mine.fit.point), gain_by_bic(mine.fit, other.fit)

    @staticmethod
    def losses(candidates: Sequence[Compared]) -> np.ndarray:
        """Mean logarithm of the squared error over blocks, what the paired test compares, (candidate,); of the fitted
        windows where nothing judges.

        Of blocks of one length for all, that of what leaves least, for it is lower the shorter they are: that of two
        independent numbers, over their number, is 0.2 below that of three.
        """
        judged = [c.select for c in candidates if c.select is not None]
        if len(judged) < len(candidates):
            return np.log([c.fit.penalised_squares for c in candidates])
        length = _block_length(min(judged, key=lambda part: part.penalised_squares.sum()))
        return np.array([np.log(np.maximum(part.blocks(length), REGRESSION.tiny)).mean() for part in judged])

    def _indistinct(self, best: Compared, other: Compared) -> bool:
        if _similarity(best, other) > SETTINGS.same_response:
            return True
        as_likely = abs(self._behind(best, other)) < SETTINGS.as_likely
        if as_likely or best.select is None:
            return bool(as_likely)
        first, second = (best, other) if self._behind(best, other) >= 0 else (other, best)
        return self._paired(second.select, first.select) > SETTINGS.indistinct

    def _behind(self, best: Compared, other: Compared) -> float:
        """How far `other` is behind `best` in twice the log likelihood of the windows that judge."""
        own, of_other = self.losses([best, other])
        return effective_samples(best.fit) * float(of_other - own)

    def best(self, mine: Candidate, others: list[Candidate]) -> tuple[Candidate, list[Candidate]]:
        """The candidate that no other is better than, and the others. None that was beaten comes back.

        Of those that do as well the plainer: with the fewest parameters, or one that MuJoCo has itself, which is
        exported without a companion.
        """
        beaten: list[Candidate] = []
        while True:
            left = [c for c in others if not any(c is b for b in beaten)]
            better = next((c for c in left if self.compare(mine, c) is None), None)
            if better is None:
                break
            beaten.append(mine)
            mine, others = better, [mine, *(c for c in others if c is not better)]
        plainer = [c for c in others if self._is_plainer(mine, c)]
        if not plainer:
            return mine, others
        plainest = min(plainer, key=lambda c: len(c.fit.point))
        return plainest, [mine, *(c for c in others if c is not plainest)]

    def _is_plainer(self, mine: Candidate, other: Candidate) -> bool:
        """Whether `other` is tied with `mine`, no worse by what counts, and has parameters less, or as many, and
        MuJoCo has it and not `mine`.
        """
        places = [c.placed.effect.place == "model" for c in (mine, other)]
        more, gain = self._more_and_gain(mine, other)
        simpler = more < 0 or (more == 0 and places == [False, True])
        return simpler and gain > -SETTINGS.as_plain and self.compare(mine, other) == Reason.TIED

    def compare(self, mine: Candidate, other: Candidate) -> Reason | None:
        """Why `other` is no better in the place of `mine`: it is tied with it, or does less, or has more parameters.
        None where it is better.
        """
        more, gain = self._more_and_gain(mine, other)
        whole = self._whole(mine, other)
        if more > 0 and whole < SETTINGS.clearly_better:
            is_scored = None not in (mine.score, other.score)
            is_same = is_scored and similarity(mine.score.response, other.score.response) > SETTINGS.same_here
            # what more parameters are worth to windows that no fit saw is no matter of their number
            is_ahead = mine.select is not None and self._behind(mine, other) < -SETTINGS.as_likely
            can_be = is_same or is_ahead or whole > 0
            return Reason.TIED if can_be and self._indistinct(mine, other) else Reason.MORE_PARAMETERS
        if not self._indistinct(mine, other):
            # where fitted and judging windows disagree, the sum of both decides
            if min(abs(gain), abs(whole)) <= SETTINGS.strong:
                return Reason.TIED
            return Reason.EXPLAINS_LESS if whole < 0 else None
        if abs(gain) > SETTINGS.clearly_better + chance(mine.fit, other.fit):
            return Reason.EXPLAINS_LESS if gain < 0 else None
        return Reason.TIED


def initial_states_found(folds: Folds, fitted: np.ndarray, judged: np.ndarray | None) -> np.ndarray:
    """Corrections (window, state) of the initial states where a refit begins: those that were `fitted`, and those found
    where the fit was `judged`, (window, state) both; none of other windows.
    """
    corrections = np.zeros((len(folds.fit), fitted.shape[1]))
    corrections[folds.fit] = fitted
    if judged is not None and len(folds.folds) == 1:
        [(_, judging)] = folds.folds
        corrections[judging] = judged
    return corrections


def _similarity(one: Compared, other: Compared) -> float:
    """Cosine of their responses; 0 where an effect has no size, or there are several effects."""
    scores = one.score, other.score
    if None in scores or not all(c.placed.effect.parameters for c in (one, other)):
        return 0.0
    return similarity(*(s.response for s in scores))


def gain_by_bic(before: Fit, after: Fit) -> float:
    """What `after` gains over `before` by the Bayesian information criterion."""
    more = len(after.point) - len(before.point)
    return bic_gain(before.penalised_squares, after.penalised_squares, effective_samples(after), more)


def chance(one: Fit, other: Fit) -> float:
    """How much of BIC two fits may differ by because of what their hidden states took of the noise."""
    taken = one.at.taken_by_hidden.sum() + other.at.taken_by_hidden.sum()
    return SETTINGS.chance * float(np.sqrt(2 * taken))


def _block_length(judged: PartFit) -> int:
    """Steps of blocks that are about independent, and in which the noise evens out."""
    independent = CRITERION.block_times * judged.correlation_steps
    steps = min(CRITERION.block_steps, judged.measured_steps / CRITERION.blocks)
    return int(np.ceil(max(independent, steps)))


def effective_samples(fit: Fit) -> float:
    """How many independent numbers are in what the fit leaves, beyond those that its windows' initial states took."""
    data = fit.at.data
    residual = fit.at.residual.reshape(data.measured.shape)
    return (data.count - fit.at.fitted_initial) / correlation_samples(residual, data.mask)


def _key(effects: Sequence[Placed]) -> tuple[str, ...]:
    """What a model is known by: its effects, in the order of its parameters."""
    return tuple(e.name for e in effects)
