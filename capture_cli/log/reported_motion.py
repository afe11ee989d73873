"""How the sensors' numbers moved shortly before windows begin, and the initial states that were read off them."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    most_late: float = 0.25  # s, before a window begins that the sensors' numbers are looked at
    knot_interval: float = 0.025  # s, or one sample where they are further apart
    # s, within which what a sensor shows beside the motion (a motor's force) may grow to its most
    growth: float = 0.1


@dataclass(frozen=True)
class ReportedMotion:
    """How the numbers of a log moved up to where its windows begin, and which coordinates were read off them.

    path (window, knot, 3, column): value, slope and curvature, per s and s^2, of each column of sensordata; 0 where it
    is not an output. before (window, knot): s, how long before the window that was; 0 first, then increasing.
    position, velocity, slope: (column, tangent coordinate, weight) of which each is the sum. orientation: of each
    attitude its four columns, the joint's orientation of these (4, 4), its tangent coordinates and their velocities;
    None where another sensor gives those.
    lag: s, how long before the time of a state its velocity is that of its path. read (window,): False for initial
    states that are known without sensors.
    """

    path: np.ndarray
    before: np.ndarray
    position: tuple[tuple[int, int, float], ...]
    velocity: tuple[tuple[int, int, float], ...]
    slope: tuple[tuple[int, int, float], ...]
    orientation: tuple[tuple[slice, np.ndarray, slice, slice | None], ...]
    lag: float
    read: np.ndarray

    @property
    def derivatives(self) -> np.ndarray:
        """The path where the windows begin, (window, 3, column)."""
        return self.path[:, 0]

    def rows(self, keep) -> Self:
        """That of the windows at `keep`."""
        return replace(self, path=self.path[keep], before=self.before[keep], read=self.read[keep])

    def at(self, before: np.ndarray) -> np.ndarray:
        """The path (window, 3, column) `before` (window, column) s before the windows begin."""
        derivatives = self.derivatives
        for k in range(self.path.shape[1] - 1):
            later, earlier = self.before[:, k, None], self.before[:, k + 1, None]
            between = _quintic(self.path[:, k], self.path[:, k + 1], earlier - later, before - later)
            derivatives = np.where((before > later)[:, None], between, derivatives)
        return derivatives

    def initial_change(self, true: np.ndarray, states: int, substeps: int = 1) -> np.ndarray:
        """How far initial states move, (simulation, state), where the derivatives (simulation, 3, column) are `true`.

        substeps: that are simulated for each step of the model: velocities are that much nearer to those of the path.
        Orientations by a rotation vector in the frame of the body, rad, in which their velocities are given, too.
        """
        lag = self.lag / substeps
        slope = (true[:, 1] - lag * true[:, 2]) - (self.derivatives[:, 1] - self.lag * self.derivatives[:, 2])
        found = self._of_states(true[:, 0] - self.derivatives[:, 0], slope, states)
        for columns, weights, rotation, turning in self.orientation:
            then, now = self.derivatives[..., columns] @ weights.T, true[..., columns] @ weights.T
            found[:, rotation] = _rotation(then[:, 0], now[:, 0])
            if turning is None:
                continue
            later = _turning(now[:, 0], now[:, 1] - lag * now[:, 2])
            found[:, turning] = later - _turning(then[:, 0], then[:, 1] - self.lag * then[:, 2])
        return found * self.read[:, None]

    def unseen(self, states: int) -> np.ndarray:
        """How far a state `most_late` before the log began may be from one of even acceleration, (window, state)."""
        acceleration = self.derivatives[:, 2]
        found = np.abs(
            self._of_states(
                SETTINGS.most_late**2 / 2 * acceleration, SETTINGS.most_late * acceleration, states
            )
        )
        for columns, weights, rotation, turning in self.orientation:
            derivatives = self.derivatives[..., columns] @ weights.T
            turned = np.abs(_turning(derivatives[:, 0], derivatives[:, 2]))
            found[:, rotation] = SETTINGS.most_late**2 / 2 * turned
            if turning is not None:
                found[:, turning] = SETTINGS.most_late * turned
        return found * self.read[:, None]

    def off_by(self, beside: np.ndarray, states: int) -> np.ndarray:
        """How far states may be off, (window, state), where sensors show up to `beside` (column,) beside the motion."""
        every = np.repeat(beside[None], len(self.path), axis=0)
        return np.abs(self._of_states(every, every / SETTINGS.growth, states)) * self.read[:, None]

    def of_coordinates(self, numbers: np.ndarray, count: int) -> np.ndarray:
        """Mean of numbers (window, column) over the columns that each of so many positions was read off, (window,
        coordinate).
        """
        total, weight = np.zeros((len(numbers), count)), np.zeros(count)
        for column, state, own in self.position:
            total[:, state] += abs(own) * numbers[:, column]
            weight[state] += abs(own)
        return total / np.where(weight > 0, weight, 1.0) * self.read[:, None]

    def _of_states(self, value: np.ndarray, slope: np.ndarray, states: int) -> np.ndarray:
        """(window, state) of what was read off columns whose values and slopes are these, (window, column) each."""
        found = np.zeros((len(value), states))
        for numbers, terms in ((value, (*self.position, *self.velocity)), (slope, self.slope)):
            for column, state, weight in terms:
                found[:, state] += weight * numbers[:, column]
        return found


def _rotation(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """From the quaternions `start` to `end` (window, 4) of any length, in the frame of `start`: (window, 3), rad."""
    scalar, vector = _quotient(start, end)
    size = np.linalg.norm(vector, axis=-1, keepdims=True)
    angle = 2 * np.arctan2(size, np.abs(scalar))
    return np.copysign(1.0, scalar) * vector * np.divide(angle, size, out=np.zeros_like(size), where=size > 0)


def _turning(quaternions: np.ndarray, derivative: np.ndarray) -> np.ndarray:
    """Angular velocity (window, 3), in the body's frame, of quaternions (window, 4) of any length with that derivative.

    Of the second derivative, in the same way, the angular acceleration.
    """
    _, vector = _quotient(quaternions, derivative)
    squared = np.square(quaternions).sum(axis=-1, keepdims=True)
    return 2 * np.divide(vector, squared, out=np.zeros_like(vector), where=squared > 0)


def _quotient(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The quaternions conj(a) b, of (window, 4) each: scalar (window, 1) and vector (window, 3)."""
    vector = a[..., :1] * b[..., 1:] - b[..., :1] * a[..., 1:] - np.cross(a[..., 1:], b[..., 1:])
    return (a * b).sum(axis=-1, keepdims=True), vector


def _quintic(later: np.ndarray, earlier: np.ndarray, interval: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Derivatives (window, 3, column) `back` (window, column) s before `later`, `earlier` being `interval` s before.

    Of the polynomial that has value, slope and curvature of both.
    """
    h, u = interval, back
    # time runs backwards from the later one
    c0, c1, c2 = later[:, 0], -later[:, 1], later[:, 2] / 2
    value = earlier[:, 0] - (c0 + c1 * h + c2 * h**2)
    slope = (-earlier[:, 1] - (c1 + 2 * c2 * h)) * h
    curvature = (earlier[:, 2] - 2 * c2) * h**2
    c3 = (10 * value - 4 * slope + curvature / 2) / h**3
    c4 = (-15 * value + 7 * slope - curvature) / h**4
    c5 = (6 * value - 3 * slope + curvature / 2) / h**5
    powers = (c0, c1, c2, c3, c4, c5)
    return np.stack(
        [
            sum(c * u**n for n, c in enumerate(powers)),
            -sum(n * c * u ** (n - 1) for n, c in enumerate(powers) if n > 0),
            sum(n * (n - 1) * c * u ** (n - 2) for n, c in enumerate(powers) if n > 1),
        ],
        axis=1,
    )


def extended(path: np.ndarray, before: np.ndarray, known: np.ndarray) -> np.ndarray:
    """`path` (window, knot, 3, column) with knots that are not `known` (window, knot) going on evenly accelerated."""
    path = path.copy()
    for k in range(1, path.shape[1]):
        back = (before[:, k] - before[:, k - 1])[:, None]
        value, slope, curvature = np.moveaxis(path[:, k - 1], 1, 0)
        on = np.stack(
            [value - back * slope + back**2 / 2 * curvature, slope - back * curvature, curvature], axis=1
        )
        path[:, k] = np.where(known[:, k, None, None], path[:, k], on)
    return path
