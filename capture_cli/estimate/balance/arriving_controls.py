"""Controls as actuators receive them, behind effects that delay or change them, about the points of a smoothed log."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from capture_cli.estimate.balance.motion import SmoothedLog
from capture_cli.estimate.balance.points import Points
from capture_cli.log.input_sequences import LoggedInputs
from capture_cli.log.windows import SETTINGS as WINDOWS
from capture_cli.model.effects._actuator_effect import ActuatorEffect
from capture_cli.model.effects.base import AtValues, Effect


class ArrivingControls:
    """The smooth control whose mean about each point is the sent one's: as the smoothed motion, it has what changes
    slower than points follow one another. A mean alone has less of that, by (w T)^2 / 24 at a frequency w.

    A step of the model takes a control for the acceleration in the middle of the step: q(t+h) - 2 q(t) + q(t-h) is
    h^2 a(t), so that what is held from t to t + h acts as if it were held from t - h / 2 to t + h / 2.
    """

    def __init__(self, smoothed: SmoothedLog, points: Points):
        self.smoothed, self.points = smoothed, points

    def behind(self, driving: Sequence[Sequence[AtValues]]) -> np.ndarray:
        """ctrl (variant, point, nu) with the same effects on it, in each variant at other values."""
        found = np.repeat(self._sent[None], len(driving), axis=0)
        columns = _driven_columns([effect for effect, _ in driving[0]], found.shape[-1])
        if not columns.size:
            return found
        time, step = self.smoothed.log.time, self.smoothed.task.timestep

        def drive(controls: np.ndarray, part: np.ndarray, variant: np.ndarray) -> np.ndarray:
            first = self._followed_from[part]
            elapsed = time[first] - time[self.smoothed.episode_start[part]]
            for same in zip(*driving, strict=True):
                values = np.stack([v for _, v in same])[variant]
                effect = same[0][0]
                own = effect.among(columns) if isinstance(effect, ActuatorEffect) else effect
                controls = own.drive(controls, values, step, elapsed=elapsed, first=first)
            return controls

        found[..., columns] = self._at_points(drive, len(driving), columns)
        return found

    @cached_property
    def _sent(self) -> np.ndarray:
        """ctrl (point, nu) as it is sent."""
        every = np.arange(self.smoothed.task.model.nu)
        return self._at_points(lambda controls, *_: controls, 1, every)[0]

    @cached_property
    def _followed_from(self) -> np.ndarray:
        """The step of the log from which controls are followed to each stretch, (stretch,): earlier ones still act."""
        time, found = self.smoothed.log.time, []
        for part, episode in zip(self.smoothed.parts, self.smoothed.episode_start, strict=True):
            found.append(
                max(episode, int(np.searchsorted(time[: part.start], time[part.start] - WINDOWS.lead)))
            )
        return np.array(found)

    @cached_property
    def _sequences(self) -> tuple[np.ndarray, np.ndarray]:
        """Controls (stretch, grid, nu) on the model's grid, and its time, s."""
        task, log = self.smoothed.task, self.smoothed.log
        spans = [slice(int(a), p.stop) for a, p in zip(self._followed_from, self.smoothed.parts, strict=True)]
        longest = max(log.time[s.stop - 1] - log.time[s.start] for s in spans)
        grid = np.arange(int(np.ceil(longest / task.timestep)) + 2) * task.timestep
        found = []
        for span in spans:
            time = log.time[span] - log.time[span.start]
            inputs = LoggedInputs(time, log.inputs[span], task.timestep, task.holds).at(grid)
            found.append(task.controls(inputs[None])[0])
        return np.array(found), grid

    def _at_points(self, drive: Callable, variants: int, columns: np.ndarray) -> np.ndarray:
        """The `columns` of ctrl at the points, (variant, point, column): derivatives of what they add up to."""
        smoothed, points, parts = self.smoothed, self.points, len(self.smoothed.parts)
        found = np.zeros((variants, len(points), len(columns)))
        if not smoothed.task.inputs:
            return found
        sequences, grid = self._sequences
        step = grid[1] - grid[0]
        variant, part = (i.ravel() for i in np.indices((variants, parts)))
        controls = drive(sequences[..., columns][part], part, variant)
        edges = np.append(grid, grid[-1] + step) - smoothed.task.timestep / 2
        total = np.cumsum(np.concatenate([np.zeros_like(controls[:, :1]), controls], axis=1), axis=1) * step
        time = smoothed.log.time
        for n, own in enumerate(points.stretches):
            if own.start == own.stop:
                continue
            at = points.time[own] - (time[self._followed_from[n]] - time[0])
            bounds = np.clip(_bounds(at, points.interval), edges[0], edges[-1])
            sums = _between(bounds, edges, total[n::parts])  # of each variant
            found[:, own] = CubicSpline(bounds, sums, axis=1)(at, nu=1)
        return found


def _bounds(at: np.ndarray, interval: float) -> np.ndarray:
    """Of what is about each point (point,): halfway to its neighbours, (point + 1,)."""
    half = interval / 2
    return np.concatenate([at[:1] - half, (at[1:] + at[:-1]) / 2, at[-1:] + half])


def _between(at: np.ndarray, grid: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (variant, grid, column) at points between (point,): as np.interp of each, all at once."""
    before = np.clip(np.searchsorted(grid, at, side="right") - 1, 0, len(grid) - 2)
    slope = (values[:, before + 1] - values[:, before]) / (grid[before + 1] - grid[before])[:, None]
    return slope * (at - grid[before])[:, None] + values[:, before]


def _driven_columns(effects: Sequence[Effect], count: int) -> np.ndarray:
    """The columns of ctrl, of so many, that effects on controls read or change; all, where they do not say."""
    if not all(isinstance(e, ActuatorEffect) for e in effects):
        return np.arange(count)
    return np.unique(np.concatenate([np.zeros(0, dtype=int), *(e.columns for e in effects)]))
