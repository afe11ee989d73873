"""How inputs act between rows of a log in which something is missing: asked with the best single effect in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from capture_cli.estimate.balance.input_timing import (
    SETTINGS,
    InputTiming,
    commands_told_apart,
    is_surely_better,
    sum_and_error,
)
from capture_cli.estimate.balance.screening import BalancedModel, Screening
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.model.tasks.base import Task
from capture_cli.select.balance_scores import screening_of
from capture_cli.select.beam import BeamSettings, grown
from capture_cli.select.candidates import Candidate
from capture_cli.select.criterion import bic_gain
from capture_cli.select.log_parts import LogParts
from capture_cli.select.model_comparison import SETTINGS as COMPARISON
from capture_cli.select.model_comparison import effective_samples

NARROW = BeamSettings(width=2, branches=2, pairs=4)


def timings_with_effects(
    prepared: PreparedLog,
    candidates: Sequence[Candidate],
    prepared_as: Callable[[Task], PreparedLog],
    threads: int | None,
    on_work: Callable[[], None] = lambda: None,
) -> tuple[tuple[InputTiming, ...], Screening | None]:
    """How the inputs act of which the task does not say it, all alike: by the force balance where that is sure, and by
    simulations otherwise; with the screening of the candidates in that reading. None where the log gives no balance.
    They are held where the other reading leaves more than noise: what is missing may look like it. Of two effects one
    may make up for the reading: held inputs are like a delay of what changes evenly. Then simulations decide, too.
    Inputs that change are asked last for commands between rows.

    prepared: with the task as it was given, and what the declared model alone says of its inputs; where that explains
    the log with inputs that change evenly, one effect with held ones has to be surely better. prepared_as: makes the
    log ready for another task. on_work is called before what takes long, which it may end by raising.
    """
    tasks = [_read(prepared.task, commands) for commands in (1.0, np.inf)]
    log = replace(prepared, task=tasks[0])
    screening = screening_of(log, LogParts.of(log).folds.balance, candidates, threads, lambda *_: on_work())
    if screening is None:
        return (), None
    screening.on_work = on_work
    screenings = [screening, screening.read_as(tasks[1].commands)]
    told = any(t.commands != 1 for t in prepared.input_timings)
    models = held, evenly = [own.best() for own in screenings] if told else _best(screenings)
    linear = not is_surely_better(evenly.likelihood, held.likelihood)
    if linear and not told:
        linear = evenly.beyond_noise < SETTINGS.else_missing and (
            _is_simply_better(held, evenly)
            or _fits_better([(prepared_as(t), m) for t, m in zip(tasks, models, strict=True)], threads)
        )
    gains = evenly.likelihood - held.likelihood
    gain, error = sum_and_error(gains if linear else -gains)
    commands, screening = _between_rows(screenings[1], evenly, prepared.task) if linear else (1.0, screening)
    asked = (c.name for c in prepared.task.inputs if c.commands is None)
    return tuple(InputTiming(name, commands, gain, error) for name in asked), screening


def _between_rows(evenly: Screening, best: BalancedModel, task: Task) -> tuple[float, Screening]:
    """How many commands from row to row there are of inputs that change, and the screening with these.

    best: of the screening with an even change. What the record explains needs no effect: that number is taken which is
    best with the same effects, where none or those of `best` are in, unless `best` is surely better than the best model
    with that number.
    """
    known = [evenly.fitted(replace(best, effects=(), values=())), *([best] if best.effects else [])]
    most, told = 0.0, (np.inf, evenly, best)
    for number in map(float, commands_told_apart(evenly.balance)):
        own = evenly.read_as(_read(task, number).commands)
        fitted = [own.fitted(model) for model in known]
        gain = max(model.gain(before)[0] for before, model in zip(known, fitted, strict=True))
        if gain > most:
            most, told = gain, (number, own, fitted[-1])
    number, screening, model = told
    rival = max((model, screening.best()), key=lambda m: m.likelihood.sum())
    return (np.inf, evenly) if is_surely_better(rival.likelihood, best.likelihood) else (number, screening)


def _best(screenings: Sequence[Screening]) -> list[BalancedModel]:
    """The best model of each reading with one effect at most; where these do not decide, with two at most: what else
    is missing may look like another reading. Where they leave far more than noise, two will not do either.

    A search stops at one effect where a second is not surely better. So each reading is asked with the effects that the
    other has, too: of two models the likelihoods would not be of the readings alone.
    """
    models = [own.best() for own in screenings]
    if _decide(*models) or min(m.beyond_noise for m in models) >= SETTINGS.hopeless:
        return models
    largest = [list(grown(own, (), (), 2, settings=NARROW))[-1:] for own in screenings]
    found = [levels[0].best if levels else one for levels, one in zip(largest, models, strict=True)]
    others = [own.fitted(model) for own, model in zip(screenings, reversed(found), strict=True)]
    return [max(both, key=lambda m: m.likelihood.sum()) for both in zip(found, others, strict=True)]


def _is_simply_better(held: BalancedModel, evenly: BalancedModel) -> bool:
    """Whether the second reading is surely better without two effects, of which one may make up for the first."""
    simple = max(len(m.effects) for m in (held, evenly)) < 2
    return simple and is_surely_better(held.likelihood, evenly.likelihood)


def _decide(one: BalancedModel, other: BalancedModel) -> bool:
    """Whether one reading is surely better, and no more is left than noise."""
    explained = min(one.beyond_noise, other.beyond_noise) < SETTINGS.else_missing
    gains = (one.likelihood, other.likelihood), (other.likelihood, one.likelihood)
    return explained and any(is_surely_better(*pair) for pair in gains)


def _read(task: Task, commands: float) -> Task:
    """The task with all inputs read alike of which it does not say how they act."""
    known = copy(task)
    known.inputs = tuple(replace(c, commands=commands) if c.commands is None else c for c in task.inputs)
    return known


def _fits_better(readings: Sequence[tuple[PreparedLog, BalancedModel]], threads: int | None) -> bool:
    """Whether the last of two readings, each with its model fitted by simulations, is clearly better: the effect that
    is in may not be the right one, so a little better is not enough.
    """
    before, after = (_fit(log, model, threads) for log, model in readings)
    if before is None or after is None:
        return before is None and after is not None
    squares = before.penalised_squares, after.penalised_squares
    more = len(after.point) - len(before.point)
    return bic_gain(*squares, effective_samples(after), more) > COMPARISON.clearly_better


def _fit(prepared: PreparedLog, model: BalancedModel, threads: int | None) -> Fit | None:
    part = prepared.part(np.flatnonzero(~prepared.split.is_test))
    return ModelFits(prepared, threads).fit(part, model.effects, model.start)
