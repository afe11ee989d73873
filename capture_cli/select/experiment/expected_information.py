"""What episodes would add to an estimate: the precision that a fit of their windows has, initial states eliminated.

Sensitivities are differences over what is still open, one standard deviation to either side along each axis of the
covariance, but no shorter than finite differences of a fit are. Where the slopes to the two sides differ, half their
difference is what no linear model accounts for: the information of that is taken off. Of a smooth curve it is next to
nothing; of one that jumps at every contact, or of chaos, it is as much as the slopes seem to tell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.linearization import Linearization, Trial, columns
from capture_cli.model.parameters import ParameterSpace
from capture_cli.simulate.simulator import Simulator


@frozen
class SETTINGS:
    largest_step: float = 0.3  # of the range: how far from the estimate it is looked, where more is open


@dataclass(frozen=True)
class Axes:
    """Of a covariance in the unit cube: directions (parameter, axis), of length 1, and the sd along each, (axis,).

    step (axis,): how far differences go to either side.
    """

    directions: np.ndarray
    sd: np.ndarray
    step: np.ndarray

    @classmethod
    def of(cls, space: ParameterSpace, covariance: np.ndarray) -> Axes:
        """covariance (p, p), in the parameters' own units."""
        values, directions = np.linalg.eigh(covariance / np.outer(space.span, space.span))
        sd = np.sqrt(np.maximum(values, 0.0))
        shortest = np.sqrt(np.square(directions.T) @ np.square(space.steps))
        return cls(directions, sd, np.clip(sd, shortest, SETTINGS.largest_step))

    def points(self, x: np.ndarray) -> np.ndarray:
        """x (parameter,), then the points a step up from it, then those a step down, in the unit cube (point, p).

        x is moved inwards, by a step at most, where that would leave the cube.
        """
        moves = (self.directions * self.step).T
        reach = np.minimum(np.abs(moves).max(axis=0, initial=0.0), 0.5)
        x = np.clip(x, reach, 1 - reach)
        return np.concatenate([x[None], x + moves, x - moves])

    def covariance(self, left: np.ndarray) -> np.ndarray:
        """Of parameters in the unit cube, (..., p, p), when `left` (..., axis, axis) of each axis' variance is left."""
        spread = self.directions * self.sd
        return spread @ left @ spread.T


@dataclass(frozen=True)
class Sensitivities:
    """Of windows, per sd along each axis: `slope`, and `bend`, which is half of what two one-sided slopes differ by.

    diverged (window,): whether any of the simulations did, so that nothing is known.
    """

    slope: Linearization
    bend: Linearization
    diverged: np.ndarray

    def precision(self, which: np.ndarray, k: float) -> np.ndarray:
        """What the windows `which` (window,) add along the axes, over what is known (axis, axis); k: as in a fit."""
        told, not_linear = (at.windows(which).normal(k)[0] / k for at in (self.slope, self.bend))
        values, vectors = np.linalg.eigh(told - not_linear)
        return (vectors * np.maximum(values, 0.0)) @ vectors.T


def sensitivities(
    prepared: PreparedLog, simulator: Simulator, point: np.ndarray, axes: Axes
) -> Sensitivities:
    """Of all windows about `point` (parameter,), where they begin where `prepared` has them begin."""
    data = prepared.data(simulator)
    points = axes.points(simulator.space.to_unit(point))
    corrections = np.zeros_like(data.initial_sd)
    initial = columns(data, points[0], corrections, parameters=False)
    about = np.repeat(corrections[None], len(points) - 1, axis=0)
    trial = Trial(
        np.concatenate([initial.parameters, simulator.space.from_unit(points[1:])]),
        np.concatenate([initial.corrections, about]),
    )
    outputs, diverged = prepared.evaluate(simulator, trial)
    own = slice(len(initial))
    at = Linearization.from_columns(
        data, points[0], corrections, outputs[own], diverged[own], parameters=False
    )
    change = at.residual - data.residual(outputs[len(initial) :])
    up, down = np.moveaxis(change.reshape(2, len(axes.sd), *at.residual.shape), 1, -1)
    scale = axes.sd / axes.step
    slope, bend = ((up - down) / 2 * scale, (up + down) / 2 * scale)
    return Sensitivities(
        replace(at, by_parameter=slope), replace(at, by_parameter=bend), diverged.any(axis=0)
    )


def information(precision: np.ndarray) -> tuple[float, np.ndarray]:
    """Expected gain, nats, of a precision (axis, axis) over what is known, and what is left of it, (axis, axis).

    The gain is log det(1 + P) / 2 (Lindley 1956, for Gaussians), by which a D-optimal experiment is chosen.
    """
    whole = np.eye(len(precision)) + precision
    return float(np.linalg.slogdet(whole)[1] / 2), np.linalg.inv(whole)
