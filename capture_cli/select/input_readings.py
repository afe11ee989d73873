"""How inputs act between rows of a log in which something is missing: asked with the best single effect in."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture_cli.common.evenly_spread import evenly_spread
from capture_cli.estimate.balance.balanced_model import BalancedModel
from capture_cli.estimate.balance.input_timing import (
    SETTINGS,
    InputTiming,
    Likelihoods,
    held_late,
    is_alike,
    is_held,
    is_surely_better,
    likeliest,
)
from capture_cli.estimate.balance.screening import SETTINGS as SCREENING
from capture_cli.estimate.balance.screening import Screening
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.log_balance import with_timings
from capture_cli.estimate.model_fits import USUAL, Effort, ModelFits
from capture_cli.estimate.noise.lack_of_fit import lack_of_fit
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.time_step import FINER
from capture_cli.log.input_sequences import EVENLY, HELD, Hold
from capture_cli.model.effects.placed import names_of
from capture_cli.model.tasks.base import Task
from capture_cli.select.balance_scores import screening_of
from capture_cli.select.candidates import Candidate
from capture_cli.select.log_parts import SETTINGS as LOG_PARTS
from capture_cli.select.log_parts import LogParts
from capture_cli.select.model_comparison import SETTINGS as COMPARISON
from capture_cli.select.model_comparison import chance, gain_by_bic
from capture_cli.select.search.answer import Accepted
from capture_cli.select.search.beam import BeamSettings, grown

NARROW = BeamSettings(width=2, branches=2, pairs=4)
PreparedAs = Callable[[Task], PreparedLog]


@dataclass(frozen=True)
class Reading:
    """A log whose inputs act as `hold` says, of which the task does not say it: its screening, and its best model."""

    unread: Task
    hold: Hold
    screening: Screening
    model: BalancedModel

    def with_best(self, hold: Hold) -> Reading:
        """With the best model of one effect at most, its inputs acting so."""
        own = self._declared_as(hold)
        return replace(self, hold=hold, screening=own, model=own.best())

    def _declared_as(self, hold: Hold) -> Screening:
        return self.screening.declared_as(read_as(self.unread, hold).holds)

    @property
    def task(self) -> Task:
        return read_as(self.unread, self.hold)

    @property
    def declared(self) -> BalancedModel:
        """The model without effects."""
        return replace(self.model, effects=(), values=())

    def without_effects(self) -> Reading:
        """With the declared model alone."""
        return replace(self, model=self.screening.fits.judged(self.declared))

    def half_a_step_later(self) -> Reading | None:
        """Of held inputs: that they act so, as those of a machine do, with its best model; None where that predicts no
        more of this one's models, or leaves more than noise: something else that is missing may look like it.
        """
        later = held_late(self.unread, 0.5)
        own = self.screening.read_as(read_as(self.unread, later).holds)
        asked = [self.screening.fits.judged(self.declared), self.model]
        if not any(is_surely_better(m.likelihood, own.fits.judged(m).likelihood) for m in asked):
            return None
        found = self.with_best(later).with_best_of([self])
        return found if found.model.beyond_noise < SETTINGS.asked_again else None

    def simpler(self) -> list[Reading]:
        """With one effect of fewer parameters in the place of its own, which the balance does not tell from that."""
        simpler = [replace(self, model=model) for model in self.screening.simpler(self.model)]
        return [reading for reading in simpler if not self.is_surely_better_than(reading)]

    def is_surely_better_than(self, other: Reading) -> bool:
        return is_surely_better(other.model.likelihood, self.model.likelihood)

    def likeliest(self) -> Reading:
        """Of inputs that change between rows: the reading that predicts most, with its best model of one effect at
        most. From one to a likelier one: each is read off the models of the one before, which fit that one.
        """
        known, best = [self.hold], self
        while (other := best.likelier()) is not None:
            asked_before = any(is_alike(other.hold, hold, self.screening.balance) for hold in known)
            if asked_before or best.is_surely_better_than(other):
                break
            known.append(other.hold)
            best = other
        return best

    def likelier(self) -> Reading | None:
        """Of inputs that change between rows: another reading that predicts more, and its best model of one effect at
        most; None where there is none.

        Each reading is judged by the best of the same models: an effect may make up for a wrong one.
        """
        models = self.screening.fits.all_fitted([self.declared, self.model, *self._best_additions()])
        hold = self._likeliest_by(models)
        return None if hold == self.hold else self.with_best(hold).with_best_of([self])

    def likeliest_alone(self) -> Reading:
        """Likewise, or the same reading, by the declared model alone, and with that."""
        own = self._likeliest_by([self.screening.fits.judged(self.declared)])
        return replace(self, hold=own, screening=self._declared_as(own)).without_effects()

    def _likeliest_by(self, models: Sequence[BalancedModel]) -> Hold:
        """How inputs that change between rows act, by the best of the models with each reading."""
        ours = _likeliest_model(models)

        def asked(hold: Hold) -> Likelihoods:
            own = self.screening.read_as(read_as(self.unread, hold).holds)
            return ours.likelihood, _likeliest_model([own.fits.judged(m) for m in models]).likelihood

        return likeliest(asked, self.screening.balance, self.hold)

    def _best_additions(self) -> list[BalancedModel]:
        """Models with each of the effects that promise most, as many as a search would look at first."""
        best = self.screening.additions((), (), SCREENING.polished_for_best)
        return [a.model for a in best[: SCREENING.polished]]

    def with_two(self) -> Reading:
        """With the best model of two effects, or laws at all of their places, if that is surely better, also than each
        of them alone.
        """
        levels = list(grown(self.screening, (), (), 2, settings=NARROW))
        if not levels:
            return self
        both = levels[-1].best
        alone = [
            self.screening.fits.fitted(replace(both, effects=(effect,), values=(values,)))
            for effect, values in zip(both.effects, both.values, strict=True)
        ]
        one = _likeliest_model(alone)
        return replace(self, model=both if is_surely_better(one.likelihood, both.likelihood) else one)

    def with_best_of(self, others: Sequence[Reading]) -> Reading:
        """The reading with the best of its own model and of those of others, fitted in its screening."""
        models = [self.model, *(self.screening.fits.fitted(other.model) for other in others)]
        return replace(self, model=_likeliest_model(models))


def _likeliest_model(models: Sequence[BalancedModel]) -> BalancedModel:
    """The one that predicts most; one that runs away predicts nothing."""
    return max(models, key=lambda m: np.nan_to_num(m.likelihood.sum(), nan=-np.inf))


def timings_with_effects(
    prepared: PreparedLog,
    candidates: Sequence[Candidate],
    prepared_as: PreparedAs,
    threads: int | None,
    on_work: Callable[[], None] = lambda: None,
    on_step: Callable[[str, int, int], None] = lambda *_: None,
) -> tuple[tuple[InputTiming, ...], Screening | None]:
    """How the inputs act of which the task does not say it, all alike: by the force balance where that is sure and
    leaves next to nothing, and by simulations otherwise; with the screening of the candidates in that reading. None
    where the log gives no balance. What the record explains needs no effect. Inputs are held where no other reading
    explains the log, or nearly: what is missing may look like one. So may inputs that each act in their own way, as the
    declared model says: that has to be surely better.

    prepared: with the task as it was given, and what the declared model alone says of its inputs; where that explains
    the log with one reading, one effect with the other has to be surely better, and simulations without one have to
    leave something. prepared_as: makes the log ready for another task. on_work is called before what takes long, which
    it may end by raising; on_step is told what is being tried, the number of it, and of how many.
    """
    log = replace(prepared, task=read_as(prepared.task, HELD))

    def step(what: str, number: int, total: int) -> None:
        on_work()
        on_step(what, number, total)

    screening = screening_of(log, LogParts.of(log).folds.balance, candidates, threads, step)
    if screening is None:
        return (), None
    screening.fits.on_work = on_work
    step("reading", 0, 2)
    held = Reading(prepared.task, HELD, screening, screening.best())
    held = _of_a_machine(held, prepared_as, threads)
    step("reading", 1, 2)
    told = prepared.input_timings
    holds = {t.hold for t in told}
    changing = held.with_best(_changing(holds))
    if not held.is_surely_better_than(changing):
        changing = changing.likeliest()
    if len(holds) == 1:
        known, other = (held, changing) if any(map(is_held, holds)) else (changing, held)
        if not other.is_surely_better_than(known):
            same = holds == {known.hold}
            return told if same else _timings(known, other), known.screening
        asked = [known.without_effects()]
    else:
        asked = [held.without_effects(), changing.likeliest_alone()]
    plain = _explaining(asked, prepared_as, threads)
    best = plain or _with_effects(held, changing, prepared_as, threads)
    if holds == {best.hold}:
        return told, best.screening
    if len(holds) > 1 and plain is None:
        mixed = screening.declared_as(with_timings(prepared.task, told).holds)
        if is_surely_better(best.model.likelihood, mixed.best().likelihood):
            return told, mixed
    return _timings(best, changing if is_held(best.hold) else held), best.screening


def _timings(read: Reading, other: Reading) -> tuple[InputTiming, ...]:
    """That all inputs act so of which the task does not say how they act, not as in the other reading."""
    gain, error = read.model.gain((other if read.model.effects else other.without_effects()).model)
    unread = (c.name for c in read.unread.inputs if c.hold is None)
    return tuple(InputTiming(name, read.hold, gain, error, read.model.beyond_noise) for name in unread)


def read_instead(
    accepted: Sequence[Accepted], last: Fit, other_reading: Callable[[], PreparedLog], threads: int | None
) -> PreparedLog | None:
    """The log with its inputs read otherwise, where the `last` model explains it so without effects that do as another
    reading does: those on controls, and shorter steps; None where it does not, or has none.

    accepted: the effects of the model, found in the reading that was told. other_reading: makes the log ready.
    """
    rest = [a.placed for a in accepted if not _may_be_a_reading(a)]
    if len(rest) == len(accepted):
        return None
    read = other_reading()
    own = [last.point[last.columns(e.name)] for e in rest]
    start = np.concatenate([last.point[: len(read.task.space)], *own])
    enough = lack_of_fit(last.at).threshold
    effort = Effort(to_reach=enough, needed=enough, escapes=False)
    fit = ModelFits(read, threads).fit(_some_to_fit(read), rest, start, effort=effort)
    return read if fit is not None and not lack_of_fit(fit.at).lacking else None


def read_otherwise(unread: Task, told: Collection[InputTiming], prepared_as: PreparedAs) -> PreparedLog:
    """The log with inputs that were told to act so held instead, or half a step of the model later if they are."""
    is_plain = all(t.hold == HELD for t in told)
    hold = held_late(unread, 0.5) if is_plain else HELD
    timings = tuple(InputTiming(t.name, hold, None, None, t.beyond_noise) for t in told)
    return replace(prepared_as(read_as(unread, hold)), input_timings=timings)


def _may_be_a_reading(accepted: Accepted) -> bool:
    each = [accepted.placed, *(c.placed for c in accepted.tied)]
    return any(p.effect.place == "control" or p.kind == FINER for p in each)


def _changing(told: Collection[Hold]) -> Hold:
    """How inputs act that change between rows: as the declared model alone told, of all alike, or evenly."""
    return next(iter(told)) if len(told) == 1 and not any(map(is_held, told)) else EVENLY


def _with_effects(held: Reading, changing: Reading, prepared_as: PreparedAs, threads: int | None) -> Reading:
    """One of the readings, each with its best effect: as the balance says where that leaves next to nothing, and as
    simulations say where it leaves more, for it has clocks that are off, and other effects, to first order. Where all
    leave far more than noise the balance decides: two effects will not do either.
    """
    both = held, changing
    if min(r.model.beyond_noise for r in both) >= SETTINGS.hopeless:
        return changing if changing.is_surely_better_than(held) else held
    sure = next((r for r in both if any(r.is_surely_better_than(other) for other in both)), None)
    if sure is not None and sure.model.beyond_noise < SETTINGS.asked_again:
        return sure
    explaining = _explaining(both, prepared_as, threads)
    return explaining or _with_two(held, changing, prepared_as, threads)


def _with_two(held: Reading, changing: Reading, prepared_as: PreparedAs, threads: int | None) -> Reading:
    """One of the readings, with two effects at most: what else is missing may look like another reading. Inputs are
    held where no two explain the log with inputs that change.

    A search stops at one effect where a second is not surely better. So each reading is asked with the effects that the
    other has, too: of two models the likelihoods would not be of the readings alone.
    """
    changing = changing.with_two()
    if changing.model.beyond_noise >= SETTINGS.hopeless_with_two:
        return held
    held = _of_a_machine(held.with_two(), prepared_as, threads)
    held, changing = held.with_best_of([changing]), changing.with_best_of([held])
    if held.is_surely_better_than(changing):
        return held
    other = changing.likelier()
    return _best_fit(held, [changing] if other is None else [changing, other], prepared_as, threads)


def _of_a_machine(held: Reading, prepared_as: PreparedAs, threads: int | None) -> Reading:
    """Held inputs half a step later, where simulations explain the log so without an effect, or better with the best
    one: a delay or a lag of half a step is no effect of the machine, and the balance has lags to first order.
    """
    later = None if held.hold != HELD else held.half_a_step_later()
    if later is None:
        return held
    plain = _explaining([held.without_effects(), later.without_effects()], prepared_as, threads)
    if plain is not None:
        return plain if plain.hold == later.hold else held
    return _best_fit(held, [later], prepared_as, threads)


def _explaining(readings: Sequence[Reading], prepared_as: PreparedAs, threads: int | None) -> Reading | None:
    """The reading whose model, fitted by simulations, explains the log: then nothing else is missing. None where there
    is none. Of two that explain the log the last, of inputs that change, has to be clearly better. Simpler effects are
    asked, too: with a wrong one, that the balance cannot tell from it, the right reading may do worse than the other.
    """
    each = (
        _that_explain([reading, *reading.simpler()], SETTINGS.asked_again, prepared_as, threads)
        for reading in readings
    )
    found = [_likeliest_fit(fits) for fits in each if fits]
    if not found:
        return None
    (first, before), (last, after) = found[0], found[-1]
    return last if _sure_gain(before, after) > COMPARISON.clearly_better else first


def _likeliest_fit(fits: Sequence[tuple[Reading, Fit]]) -> tuple[Reading, Fit]:
    """By BIC."""
    first = fits[0][1]
    return max(fits, key=lambda pair: gain_by_bic(first, pair[1]))


def read_as(unread: Task, hold: Hold) -> Task:
    """The task with all inputs acting alike of which it does not say how they act."""
    return unread.with_holds(c.hold or hold for c in unread.inputs)


def _best_fit(
    held: Reading, others: Sequence[Reading], prepared_as: PreparedAs, threads: int | None
) -> Reading:
    """That of the others which, each with its model fitted by simulations, comes near the log, is clearly better than
    the first with its own model or with the same, and leaves far less: the effects that are in may not be the right
    ones, and what they leave another reading may take a part of.
    """
    near = _that_explain(others, SETTINGS.else_missing, prepared_as, threads)
    if not near:
        return held
    best, after = _likeliest_fit(near)
    prepared, models = prepared_as(held.task), [held.model]
    if names_of(held.model.effects) != names_of(best.model.effects):
        models.append(held.screening.fits.fitted(best.model))
    fits = [(held, fit) for m in models if (fit := _fit(held, m, prepared, threads, USUAL)) is not None]
    if not fits:
        return best
    _, before = _likeliest_fit(fits)
    left = max(before.excess, SETTINGS.asked_again)
    is_better = _sure_gain(before, after) > COMPARISON.clearly_better
    return best if is_better and after.excess < SETTINGS.far_less * left else held


def _that_explain(
    readings: Sequence[Reading], beyond: float, prepared_as: PreparedAs, threads: int | None
) -> list[tuple[Reading, Fit]]:
    """The readings whose models, fitted by simulations, leave no more variance beyond the noise floor's than `beyond`
    times that. A fit that does not promise to is not ended, and where the balance leaves far more none is begun.
    """
    readings = [r for r in readings if r.model.beyond_noise < SETTINGS.hopeless_with_two]
    most = float(np.sqrt(1 + beyond))
    effort = Effort(to_reach=most, needed=most, escapes=False)
    tasks = {r.hold: r.task for r in readings}
    prepared = {hold: prepared_as(task) for hold, task in tasks.items()}
    fits = [(r, _fit(r, r.model, prepared[r.hold], threads, effort)) for r in readings]
    return [(r, fit) for r, fit in fits if fit is not None and fit.error < most]


def _sure_gain(before: Fit, after: Fit) -> float:
    """By BIC, beyond what hidden states may take of the noise."""
    return gain_by_bic(before, after) - chance(before, after)


def _fit(
    reading: Reading,
    model: BalancedModel,
    prepared: PreparedLog,
    threads: int | None,
    effort: Effort,
) -> Fit | None:
    """The model fitted by simulations of the log `prepared` in that reading."""
    fits = ModelFits(prepared, threads)
    fits.engine.on_work = reading.screening.fits.on_work
    return fits.fit(_some_to_fit(prepared), model.effects, model.start, effort=effort)


def _some_to_fit(prepared: PreparedLog) -> PreparedLog:
    """Of the windows that are not held out as many as a search fits, evenly spread."""
    windows = np.flatnonzero(~prepared.split.is_test)
    return prepared.part(windows[evenly_spread(len(windows), LOG_PARTS.fitted)])
