"""Escape from a poor minimum: where stops are hit or bodies touch, a descent may end where no step of it leads out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.fit import SETTINGS as FIT
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.noise.lack_of_fit import lack_of_fit
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.linearization import best_trials

if TYPE_CHECKING:
    from capture_cli.estimate.model_fits import ModelFits


@frozen
class SETTINGS:
    escapes: int = 5  # that are taken, of minima that contacts make


def escaped(
    fits: ModelFits, part: PreparedLog, fit: Fit | None, rival: Fit | None, descend: Callable[..., Fit | None]
) -> Fit | None:
    """The fit after as many escapes from local minima as contacts or stops may need; `fit` where there is none.

    descend(point (parameter,), corrections (window, state)) -> a fit of the same model. rival: another model's fit.
    """
    for _ in range(SETTINGS.escapes if fit is not None and fit.at.data.rough else 1):
        if fit is None or not fit.finished or not _may_be_stuck(fit, rival):
            break
        way = better_minimum(fits, part, fit, whole_step=fit.at.data.rough)
        further = None if way is None else descend(*way)
        if further is None or further.penalised_squares >= fit.penalised_squares:
            break
        fit = further
    return fit


def better_minimum(
    fits: ModelFits, part: PreparedLog, fit: Fit, *, whole_step: bool, worth: float = FIT.as_good
) -> tuple[np.ndarray, np.ndarray] | None:
    """A better point (parameter,), and corrections (window, state), that no step of all of them together leads to; None
    where there is none.

    Where stops are hit the start of a window has many minima, and a step of all parameters is refused for the few
    windows that it would leave in a worse one. So windows are fitted alone: where the parameters are, from where
    they begin and from where they were measured; and, where asked for, a whole step on.
    worth: of the objective over k, what an escape has to gain: one that gains less leads nowhere, and where contacts
    make the error rough there always is one.
    """
    k, before = fit.at.inflation, fit.at.objectives(fit.at.inflation)
    found = fits.initial_states_at(part, fit, FIT.tolerance, fit.corrections, np.zeros_like(fit.corrections))
    corrections = np.stack([fit.corrections, found.corrections])
    best, values = best_trials(corrections, np.stack([before, found.objectives(k)]))
    ways = [(values.sum(), fit.point, best)]
    if whole_step and len(fit.point):
        point = fit.space.from_unit(fit.at.x + fit.at.whole_step)
        there = fits.initial_states_at(part, replace(fit, point=point), FIT.tolerance, best)
        ways.append((there.objectives(k).sum(), point, there.corrections))
    value, point, corrections = min(ways, key=lambda way: way[0])
    return (point, corrections) if before.sum() - value > worth * k else None


def _may_be_stuck(fit: Fit, rival: Fit | None) -> bool:
    """Whether windows may be where no step of all parameters leads out of.

    It does not matter where a rival that does as well leaves nothing.
    """
    if rival is not None and rival.error <= fit.error and not lack_of_fit(rival.at).lacking:
        return False
    return lack_of_fit(fit.at).lacking or len(fit.at.data.standing_out(fit.at.residual)) > 0
