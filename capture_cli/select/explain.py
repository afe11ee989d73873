"""The protocol of `diagnose`, step by step: noise floor, declared model, effects one by one, what judges them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import prod
from typing import Any

import numpy as np

from capture_cli.errors import OutOfTime
from capture_cli.estimate.checkpoint import Checkpoint
from capture_cli.estimate.difference_step import difference_step
from capture_cli.estimate.fit import SETTINGS as FIT_SETTINGS
from capture_cli.estimate.fit import Fit, least
from capture_cli.estimate.held_out import HeldOut, held_out
from capture_cli.estimate.initial_states.of_windows import as_acted, begins_as_acted
from capture_cli.estimate.limits import with_limits
from capture_cli.estimate.log_balance import balanced_point
from capture_cli.estimate.log_requirements import all_diverged, check_parameters_move_outputs
from capture_cli.estimate.model_fits import Effort, ModelFits
from capture_cli.estimate.noise.lack_of_fit import lack_held_out, lack_of_fit
from capture_cli.estimate.noise.repeated_noise import with_noise_of_repeats
from capture_cli.estimate.noise.residual_noise import with_noise_of_residual, with_outliers
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.intervals import Intervals, intervals
from capture_cli.estimate.time_step import shorter_step
from capture_cli.model.effects.placed import Placed
from capture_cli.select.candidates import Candidate
from capture_cli.select.experiment.excitation_range import ExcitationRange
from capture_cli.select.experiment.next_experiment import next_experiment
from capture_cli.select.explanation import Explanation, Expression
from capture_cli.select.expression import expression_terms
from capture_cli.select.input_readings import read_instead
from capture_cli.select.judged_models import JudgedModel, JudgedModels, OnStep
from capture_cli.select.log_parts import FIT, SELECT, TEST, LogParts
from capture_cli.select.search.answer import SETTINGS as ANSWER
from capture_cli.select.search.attribution import Attribution
from capture_cli.select.time_limit import TimeLimit


@dataclass(frozen=True)
class Settings:
    """starts: of the declared model's fit, where no force balance says where to begin. most_effects: to add.
    expression: to look for a formula of what is left. checkpoint: of an earlier run of the same steps.
    """

    starts: int = 3
    most_effects: int = ANSWER.most_effects
    expression: bool = False
    seed: int = 0
    threads: int | None = None
    checkpoint: Checkpoint | None = None
    limit: TimeLimit = field(default_factory=TimeLimit)


def explain(
    prepared: PreparedLog,
    nominal: np.ndarray,
    settings: Settings,
    on_step: OnStep,
    other_reading: Callable[[], PreparedLog] | None = None,
) -> Explanation:
    """What explains the log, from the values `nominal` (parameter,) of its task. Raises FitError.

    With the initial states that the actions say, where that explains what was fitted; else with free initial states, if
    less is left so. Where contacts follow, free initial states are worse: they make the error rough, and hide what
    moves them. With a noise floor that has the outliers in it, where that is what the last model leaves. With inputs
    read otherwise than the log told, where what was found explains it so with fewer effects.

    other_reading: makes the log ready with such inputs.
    """
    rollouts = prepared.rollouts
    rollouts += check_parameters_move_outputs(prepared, seed=settings.seed, threads=settings.threads)
    prepared, more = with_noise_of_repeats(prepared, nominal, threads=settings.threads, seed=settings.seed)
    known = tuple(settings.limit.left_out)
    begun = _begin(prepared, nominal, settings, on_step, rollouts + more)
    found = begun.explain()
    if found.out_of_time:
        return found

    def otherwise(prepared: PreparedLog, what: str, *, free: bool) -> tuple[_Declared, Explanation]:
        """What is found so; as before where its search is stopped, for that before was whole."""
        settings.limit.left_out[:] = known
        with suppress(OutOfTime), settings.limit.keeping(begun.protocol.rows.closing.whole):
            other = _begin(prepared, nominal, settings, on_step, found.rollouts, free=free)
            explained = other.explain()
            if not explained.out_of_time:
                return other, explained
        return begun, replace(found, left_out=(*found.left_out, what))

    if begun.as_acted and found.leaves_something:
        freed = otherwise(begun.prepared, "a search with free initial states", free=True)
        found = replace(found, rollouts=freed[1].rollouts)
        begun, found = min(freed, (begun, found), key=lambda each: each[1].after.lacking.normalized)
    if found.leaves_something:
        fitted, after = found.parts.fitted, found.after.fit
        noisier = with_outliers(begun.prepared, fitted, after, settings.threads)
        if noisier is not begun.prepared:
            _, found = otherwise(
                noisier, "a search with outliers in the noise floor", free=not begun.as_acted
            )
    if other_reading is not None and not found.out_of_time:
        read = read_instead(found.accepted, found.after.fit, other_reading, settings.threads)
        if read is not None:
            _, found = otherwise(read, "a search with inputs read otherwise", free=not begun.as_acted)
    return found


@dataclass(frozen=True)
class _Declared:
    """The protocol with its declared model, on the log `prepared` with the noise floor that it stays with.

    as_acted: with the initial states that the actions say; then `prepared` has them as free as they were.
    """

    protocol: _Protocol
    declared: Fit
    prepared: PreparedLog
    as_acted: bool

    def explain(self) -> Explanation:
        return self.protocol.run(self.declared, last_time=not self.as_acted)


def _begin(
    prepared: PreparedLog,
    nominal: np.ndarray,
    settings: Settings,
    on_step: OnStep,
    rollouts: int,
    *,
    free: bool = False,
) -> _Declared:
    """Declare the model; on from there where what it leaves shows another noise than the log, anew where contacts
    there need longer differences, or what is fitted shows nothing of what is missing; until none is so.

    free: not with the initial states that the actions say. rollouts: how many windows were simulated before.
    """
    start, corrections = nominal, None
    while True:
        acted = not free and begins_as_acted(prepared)
        protocol = _Protocol(as_acted(prepared) if acted else prepared, settings, on_step, rollouts)
        declared = protocol.declare(start, corrections)
        better = _better_prepared(prepared, protocol, declared)
        if better is prepared:
            return _Declared(protocol, declared, prepared, acted)
        start, corrections = nominal, None
        if better.noise is not prepared.noise:
            start, fitted = declared.point, LogParts.of(better).fitted
            corrections = fitted.corrections_from(protocol.parts.fitted, declared.corrections)
        prepared, rollouts = better, protocol.fits.rollouts


def _better_prepared(prepared: PreparedLog, protocol: _Protocol, declared: Fit) -> PreparedLog:
    """`prepared` with the noise that what `declared` leaves shows, with differences as long as contacts need there, or
    with its windows dealt out by what is left of them; itself where it has all.
    """
    fitted, threads = protocol.parts.fitted, protocol.settings.threads
    quieter = with_noise_of_residual(prepared, fitted, declared, threads)
    if quieter is not prepared:
        return quieter
    step, rollouts = difference_step(fitted, threads, declared.point, declared.corrections)
    protocol.fits.rollouts += rollouts
    if step > prepared.difference_step:
        return replace(prepared, difference_step=step)
    left = None if prepared.left is not None else _left_where_it_judges(protocol, declared)
    return prepared if left is None else replace(prepared, left=left, screening=None)


def _left_where_it_judges(protocol: _Protocol, declared: Fit) -> np.ndarray | None:
    """What `declared` leaves of each window, 0 of what is held out, (window,), where it leaves something of those that
    judge and nothing of those that are fitted: these show too little of what is missing, as of rare impacts.
    """
    parts, select = protocol.parts, protocol.parts.windows(SELECT)
    if select is None or lack_of_fit(declared.at).lacking:
        return None
    judged = protocol.fits.on(select, declared)
    if not lack_held_out(judged.data, judged.residual).lacking:
        return None
    both = protocol.fits.on(parts.windows(FIT, SELECT), declared)
    left = np.zeros(len(parts.number))
    rows = np.maximum(both.data.mask.sum(axis=(1, 2)), 1)
    left[parts.number != TEST] = np.square(both.residual).sum(axis=1) / rows
    return left


class _Protocol:
    """The declared model, then effects, on one prepared log. `fits.rollouts` goes on from `rollouts`."""

    def __init__(self, prepared: PreparedLog, settings: Settings, on_step: OnStep, rollouts: int = 0):
        self.prepared = prepared
        self.settings = settings
        self.limit = settings.limit
        self.on_step = on_step
        self.parts = LogParts.of(prepared)
        fitted = np.flatnonzero(self.parts.folds.balance)
        self.balanced = balanced_point(prepared, fitted, prepared.task.space.nominal, settings.threads)
        self.fits = ModelFits(
            prepared, settings.threads, settings.checkpoint, from_balance=self.balanced is not None
        )
        self.fits.rollouts = rollouts
        self.fits.engine.on_work = self.limit.check
        self.rows = JudgedModels(self.fits, self.parts, self.limit, settings.seed, on_step)

    def declare(self, start: np.ndarray, corrections: np.ndarray | None = None) -> Fit:
        """The declared model, from `start` (parameter,) and other places, with windows begun at `corrections` (window,
        state).
        """
        own = self.settings
        declared = self.fits.fit(
            self.parts.fitted,
            [],
            start if corrections is not None else self._nearer(start),
            corrections=corrections,
            effort=Effort(
                starts=own.starts if self.balanced is None else 1, tolerance=FIT_SETTINGS.exact, seed=own.seed
            ),
        )
        if declared is None:
            raise all_diverged(self.prepared.task)
        return declared

    def _nearer(self, start: np.ndarray) -> np.ndarray:
        """Of `start` (parameter,) and what fills the force balance best the one that is nearer to the log."""
        if self.balanced is None or not len(start):
            return start
        return self.fits.nearest(self.parts.fitted, np.stack([self.balanced, start]))

    def run(self, declared: Fit, *, last_time: bool = True) -> Explanation:
        """Attribute what `declared` leaves. last_time: if what was fitted is not explained then, look for an expression
        where one is wanted.
        """
        attribution = self._attribution()
        first = self.rows.first(attribution.models, declared)
        with self.limit.keeping(self.rows.closing.after_search):
            last = attribution.run(declared)
        models = self.rows.each(attribution.models, first, last)
        after = models[-1]
        tied = next((a.tied for a in attribution.answer.accepted if a.tied), [])
        found = Explanation(
            self.parts,
            attribution.answer.accepted,
            attribution.answer.candidates,
            models,
            sure=self._limited(after),
            motion=self.fits.motion(self.prepared, after.again, after.whole.corrections),
            initial_conditions=self.fits.initial_conditions(
                self.prepared, after.again, after.whole.corrections
            ),
            held_out=self._held_out(after),
            shorter_step=shorter_step(self.fits, self._seen(after), after.again, after.intervals),
            next_experiment=self._next_experiment(after, [c.fit for c in tied]) if tied else None,
            out_of_time=attribution.out_of_time,
        )
        wanted = self.settings.expression and last_time and found.verdict == "unexplained"
        wanted = wanted and not attribution.out_of_time
        if wanted and after.lacking.lacking:
            formula = self.rows.in_time(lambda: self._expression(last, after), "a formula of what is left")
            found = replace(found, expression=formula)
        return replace(found, rollouts=self.fits.rollouts, left_out=tuple(self.limit.left_out))

    def _limited(self, model: JudgedModel) -> Intervals:
        """Its intervals, with limits of what the log does not determine."""
        found = self.rows.in_time(
            lambda: with_limits(self.fits, self._seen(model), model.again, model.intervals),
            "limits of what the log does not determine",
        )
        return found or model.intervals

    def _held_out(self, model: JudgedModel) -> HeldOut:
        """Whether it holds on the test part."""
        is_test = self.parts.number == TEST
        found = self.rows.in_time(
            lambda: held_out(self.fits, model.again, model.intervals.covariance, model.whole, is_test),
            "a fit to what was held out, too",
        )
        test = model.whole.rows(is_test)
        return found or HeldOut(lack_held_out(test.data, test.residual))

    def _next_experiment(self, mine: JudgedModel, others: Sequence[Fit]) -> dict[str, Any] | None:
        """What would tell it from the `others`."""
        return self.rows.in_time(
            lambda: next_experiment(self.fits, mine.fit, others, self.settings.seed, self._shown(mine)),
            "the experiment that would end the tie",
        )

    def _shown(self, model: JudgedModel) -> ExcitationRange:
        """How far the log shows that the machine went."""
        windows, log = self.prepared.windows, self.prepared.log
        mask = windows.mask
        measured = np.where(windows.sampled, windows.measured, np.nan)[mask]
        return ExcitationRange.of(
            self.prepared.task,
            self.prepared.noise.sd,
            time=log.time[self.prepared.log_steps][mask],
            window=np.repeat(np.arange(len(windows)), windows.samples),
            measured=measured,
            simulated=measured - model.whole.in_units[mask],
        )

    def _seen(self, model: JudgedModel) -> PreparedLog:
        """What its refit was made of."""
        return self.parts.windows(FIT, SELECT) if model.is_refitted else self.parts.fitted

    def _attribution(
        self, candidates: Sequence[Candidate] | None = None, known: Sequence[Placed] = ()
    ) -> Attribution:
        """Of the whole catalogue, or of `candidates`. known: the effects that were found before."""

        def step(what: str, number: int, total: int, found: Sequence[Placed]) -> None:
            own, closing = [*known, *found], self.rows.closing
            # in shorter steps what follows the search takes as many times longer
            slower = prod(e.effect.substeps for e in own)
            self.limit.keep((closing.after_search if candidates is None else closing.whole) * slower)
            self.limit.check()
            self.on_step(what, number, total, [e.name for e in own])

        return Attribution(
            self.fits,
            self.parts.folds,
            seed=self.settings.seed,
            most_effects=self.settings.most_effects,
            candidates=candidates,
            on_step=step,
        )

    def _from_best(self, last: Fit, again: Fit) -> Fit:
        """`last`, or the same model from where `again` ended on more of the log, where that is better: descents of it
        were begun elsewhere, too.
        """
        if again is last:
            return last
        other = self.fits.fit(
            self.parts.fitted,
            last.effects,
            again.point,
            near=last,
            corrections=again.corrections[self.parts.folds.fit[self.parts.number != TEST]],
        )
        return least([last, other])

    def _expression(self, last: Fit, after: JudgedModel) -> Expression | None:
        """A sparse expression for the force that is missing in `last`; None where no joint can have one.

        after: that model as it is reported. An expression that does no better on what was held out explains nothing.
        """
        task = self.prepared.task
        terms = expression_terms(task.model, [c.index for c in task.inputs])
        if not terms:
            return None
        search = self._attribution([Candidate(term) for term in terms], last.effects)
        found = search.run(self._from_best(last, after.again))
        if search.out_of_time:
            raise OutOfTime
        chosen = found.effects[len(last.effects) :]
        if not chosen:
            return Expression()
        selected, test = search.models.judge(found), self.parts.windows(TEST)
        again = self.rows.refitted(found, selected) or found
        tested = None if test is None else self.fits.on(test, again)
        if tested and tested.normalized >= after.whole.rows(self.parts.number == TEST).normalized:
            return Expression()
        return Expression(
            [effect for _, effect in chosen],
            again.point[-len(chosen) :],
            intervals(again.at).sd[-len(chosen) :],
            dict(zip(again.space.names, again.point.tolist(), strict=True)),
            judged=selected,
            held_out=tested,
        )
