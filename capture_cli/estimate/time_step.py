"""How much of an estimate is the model's time step: where the parameters would be at a shorter one.

What MuJoCo's integrators leave out is of the first order in the step: those that are implicit in the velocity move as
if the inertia had step times damping more. Parameters make up for it, and the error need not show it.
"""

from dataclasses import dataclass, replace

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.fit import SETTINGS as FIT
from capture_cli.estimate.fit import Fit, thinned
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.intervals import Intervals
from capture_cli.estimate.solve.linearization import Linearization
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.placed import Placed
from capture_cli.model.tasks.base import ActionTask

FINER = "finer-time-step"


@frozen
class SETTINGS:
    as_well: float = 9.0  # of the objective over k: no worse by more, a window is explained as well
    most_windows: float = 0.75  # of those simulated have to be
    # of a value, or of its range where that is larger by ten times: less is nobody's concern
    material: float = 0.003
    sure: float = 2.0  # sd of the estimate: less is lost in them
    # k up to which a residual is white, as is that of a log that was simulated in the model's own steps. Where it is
    # not, something is missing in these steps, too, and that such a model is a little better says nothing of them
    white: float = 1.5
    little: float = 0.02  # of the objective
    gain: float = 0.1  # of the error


@dataclass(frozen=True)
class ShorterStep:
    """point (parameter,): about where the parameters would be in steps of `finer` s, the model's being `step` s.

    moved: the numbers of those that would be elsewhere, by more than they are uncertain, the largest change first.
    error: over the noise floor, about what it would be there, and what it is; None where that is no gain.
    """

    step: float
    finer: float
    point: np.ndarray
    moved: list[int]
    error: tuple[float, float] | None


def shorter_step(fits: ModelFits, part: PreparedLog, fit: Fit, found: Intervals) -> ShorterStep | None:
    """What a quarter of the model's time step would make of the `fit` of the part; None where nothing, or where the log
    speaks against it, as one does that was simulated in the model's own steps.

    None as well where the task is a built-in one, or the steps are shorter already: nobody could change them.
    From one simulation of as many windows as a score needs, by the sensitivities of the fit. Where contacts make the
    error rough these hold in most windows and not in all: there the windows count that are as good in such steps once
    they are simulated where the sensitivities lead, and the log has to be better explained by them.
    """
    task = fits.prepared.task
    if not len(fit.space) or isinstance(task, ActionTask):
        return None
    if any(placed.kind == FINER for placed in fit.effects):
        return None
    model = task.model
    finer = Placed(FINER, REGISTRY.get(FINER)(model, "quarter"))
    part, at = thinned(part, fit)
    there = _in_steps_of(fits, part, replace(fit, at=at), finer)
    if there is None:
        return None
    k = at.inflation
    if at.data.rough:
        led = _in_steps_of(fits, part, _led(fit, there, k), finer)
        if led is None:
            return None
        keep = np.flatnonzero(led.objectives(k) <= at.objectives(k) + SETTINGS.as_well * k)
        if len(keep) < SETTINGS.most_windows * len(part.windows):
            return None
        at, there = at.windows(keep), there.windows(keep)
    left, begin = _lowest(at, k)
    left_there, end = _lowest(there, k)
    if left_there > left + (-FIT.as_good * k if at.data.rough else _may_be_worse(k, left)):
        return None
    change = (end - begin) * fit.space.span
    size = np.maximum(np.abs(fit.point), 0.1 * fit.space.span)
    concerns = found.identifiable & (
        np.abs(change) > np.maximum(SETTINGS.material * size, SETTINGS.sure * found.sd)
    )
    moved = [int(i) for i in np.argsort(-np.abs(change) / size) if concerns[i]]
    point = np.clip(fit.point + change, fit.space.low, fit.space.high)
    step, ratio = float(model.opt.timestep), float(np.sqrt(left_there / left))
    error = None if ratio > 1 - SETTINGS.gain else (fit.error * ratio, fit.error)
    if not moved and error is None:
        return None
    return ShorterStep(step, step / finer.effect.substeps, point, moved, error)


def _may_be_worse(k: float, left: float) -> float:
    """By how much the objective, which is `left` in the model's own steps, may be worse in shorter ones."""
    chance = FIT.as_good * k
    return chance if k < SETTINGS.white else max(chance, SETTINGS.little * left)


def _in_steps_of(fits: ModelFits, part: PreparedLog, fit: Fit, finer: Placed) -> Linearization | None:
    """The linearization of the fit with the residual of the steps of `finer`; None where a window diverges."""
    residuals, diverged = fits.probe(part, fit, finer, np.zeros((1, 0)))
    return None if diverged.any() else replace(fit.at, residual=residuals[0])


def _led(fit: Fit, there: Linearization, k: float) -> Fit:
    """The fit moved, initial states too, to where the linearization is lowest."""
    dx = there.bounded_step(k, -there.x, 1 - there.x)
    x = np.clip(there.x + dx, 0, 1)
    return replace(
        fit,
        point=fit.space.from_unit(x),
        at=replace(there, x=x, corrections=there.corrections_after(dx, k)),
    )


def _lowest(at: Linearization, k: float) -> tuple[float, np.ndarray]:
    """The objective where the linearization is lowest, and the step (parameter,) in the unit cube that leads there."""
    dx = at.bounded_step(k, -at.x, 1 - at.x)
    gain = at.predicted_gain(dx, at.corrections_after(dx, k), k)
    return float(at.objectives(k).sum()) - gain, dx
