"""How much of an estimate is the model's time step: where the parameters would be at a shorter one.

What MuJoCo's integrators leave out is of the first order in the step: those that are implicit in the velocity move as
if the inertia had step times damping more. Parameters make up for it, and the error need not show it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capture_cli.effects import REGISTRY
from capture_cli.effects.placed import Placed
from capture_cli.identifiers.intervals import Intervals
from capture_cli.linearization import Linearization
from capture_cli.protocol.candidates import thinned
from capture_cli.protocol.model_fits import AS_GOOD, Fit, ModelFits
from capture_cli.protocol.prepared_log import PreparedLog
from capture_cli.tasks.base import ActionTask

FINER = "finer-time-step"
MATERIAL = 0.003  # of a value, or of its range where that is larger by ten times: less is nobody's concern
SURE = 2.0  # sd of the estimate: less is lost in them


@dataclass(frozen=True)
class ShorterStep:
    """point (parameter,): about where the parameters would be in steps of `finer` s, the model's being `step` s.

    moved: the numbers of those that would be elsewhere, by more than they are uncertain, the largest change first.
    """

    step: float
    finer: float
    point: np.ndarray
    moved: list[int]


def shorter_step(fits: ModelFits, part: PreparedLog, fit: Fit, found: Intervals) -> ShorterStep | None:
    """What a quarter of the model's time step would make of the `fit` of the part; None where nothing, or where the log
    speaks against it, as one does that was simulated in the model's own steps.

    None as well where the task is a built-in one, or the steps are shorter already: nobody could change them.
    From one simulation of as many windows as a score needs, by the sensitivities of the fit. Where contacts make the
    error rough these say too little.
    """
    task = fits.prepared.task
    if not len(fit.space) or fit.at.evidence.rough or isinstance(task, ActionTask):
        return None
    if any(placed.kind == FINER for placed in fit.effects):
        return None
    model = task.model
    finer = Placed(FINER, REGISTRY.get(FINER)(model, "quarter"))
    part, at = thinned(part, fit)
    residuals, diverged = fits.probe(part, replace(fit, at=at), finer, np.zeros((1, 0)))
    if diverged.any():
        return None
    left, begin = _lowest(at, at.scatter)
    left_there, end = _lowest(replace(at, residual=residuals[0]), at.scatter)
    if left_there > left + AS_GOOD * at.scatter:
        return None
    change = (end - begin) * fit.space.span
    size = np.maximum(np.abs(fit.point), 0.1 * fit.space.span)
    concerns = found.identifiable & (np.abs(change) > np.maximum(MATERIAL * size, SURE * found.sd))
    moved = [int(i) for i in np.argsort(-np.abs(change) / size) if concerns[i]]
    point = np.clip(fit.point + change, fit.space.low, fit.space.high)
    step = float(model.opt.timestep)
    return ShorterStep(step, step / finer.effect.substeps, point, moved) if moved else None


def _lowest(at: Linearization, k: float) -> tuple[float, np.ndarray]:
    """The objective where the linearization is lowest, and the step (parameter,) in the unit cube that leads there."""
    dx = at.bounded_step(k, -at.x, 1 - at.x)
    gain = at.predicted_gain(dx, at.start_offsets(dx, k), k)
    return float(at.objectives(k).sum()) - gain, dx
