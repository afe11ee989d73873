"""Other minima of a model's error that explain a log as well: where contacts make it rough, and at ends of shapes."""

from itertools import product

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.balance.regression import SETTINGS as REGRESSION
from capture_cli.estimate.fit import SETTINGS as FIT
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.model_fits import Effort, ModelFits
from capture_cli.estimate.part_fit import PartFit
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.base import Best
from capture_cli.estimate.solve.intervals import unit_covariance


@frozen
class SETTINGS:
    # descents to see whether there are other minima, and how far off, in sd
    begun_anew: int = 3
    begun_away: float = 3.0
    # sd: a descent that ends as near as this to where another ended has come back to it
    returned: float = 0.5


def minima(fits: ModelFits, part: PreparedLog, fit: Fit, seed: int) -> list[Fit]:
    """`fit` and where descents end that begin within its reach, best first.

    Where contacts make the error rough it has many minima, and one descent finds one of them. Where the first of
    them comes back to `fit`, the error is taken to be smooth, and no more are begun. After them, not as the best,
    come those that differ by a shape that this part of the log does not show.
    """
    if not len(fit.space):
        return [fit]
    best, *others = _begun_anew(fits, part, fit, seed)
    return [best, *others, *_with_shapes_at_ends(fits, part, best)]


def _begun_anew(fits: ModelFits, part: PreparedLog, fit: Fit, seed: int) -> list[Fit]:
    """`fit` and where descents end that begin about it, best first."""
    covariance, _ = unit_covariance(fit.at)
    values, vectors = np.linalg.eigh(covariance)
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    sd = np.sqrt(np.maximum(np.diag(covariance), REGRESSION.tiny))
    generator = np.random.default_rng(seed)
    found = [fit]
    for _ in range(SETTINGS.begun_anew):
        begin = fit.at.x + SETTINGS.begun_away * spread @ generator.standard_normal(len(sd))
        point = fit.space.from_unit(np.clip(begin, 0, 1))
        other = fits.fit(part, fit.effects, point, near=fit, effort=Effort(rival=fit))
        if other is None:
            continue
        found.append(other)
        if len(found) == 2 and np.abs((other.at.x - fit.at.x) / sd).max() < SETTINGS.returned:
            break
    return sorted(found, key=lambda f: f.at.objectives(1.0).sum())


def _with_shapes_at_ends(fits: ModelFits, part: PreparedLog, fit: Fit) -> list[Fit]:
    """`fit` with a shape of an effect at an end of its range, where it does as well: a limit that nothing reaches.

    A descent stops where the limit is about to matter, and differences that are taken there say that it does.
    """
    shapes = [
        fit.columns(e.name).start + i
        for e in fit.effects
        for i, name in enumerate(e.effect.space.names)
        if name in e.effect.shapes
    ]
    ends = np.repeat(fit.point[None], 2 * len(shapes), axis=0)
    for row, (shape, end) in zip(ends, product(shapes, (fit.space.low, fit.space.high)), strict=True):
        row[shape] = end[shape]
    if not len(ends):
        return []
    k = fit.at.inflation
    above = fits.objectives(part, fit, PartFit.of(fit.at), ends) - fit.at.objectives(k).sum()
    as_good = above < FIT.as_good * k
    return [fits.at(part, fit.effects, Best(p, fit.corrections, 0.0)) for p in ends[as_good]]
