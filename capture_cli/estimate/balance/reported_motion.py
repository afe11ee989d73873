"""What sensors report of the smoothed motion, and what is true where effects make them report late or wrongly."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from capture_cli.estimate.balance.motion import SmoothedLog
from capture_cli.estimate.balance.points import Points
from capture_cli.model.effects.base import AtValues, Effect


class ReportedMotion:
    """Outputs with their slopes and curvatures at points of a smoothed log.

    actuator_force: gives N or N m, (point, actuator), for sensors that pick it up.
    """

    def __init__(self, smoothed: SmoothedLog, points: Points, actuator_force: Callable[[], np.ndarray]):
        self.smoothed, self.points, self.actuator_force = smoothed, points, actuator_force

    def numbers(self, late: np.ndarray, known: tuple[np.ndarray, np.ndarray] | None = None) -> np.ndarray:
        """Outputs with slope and curvature, (point, 3, output), each `late` s after (point, output). known: how late
        they are elsewhere, and the same there, whose columns stay where an output is no later.
        """
        at_known, found = (None, np.zeros((len(self.points), 3, late.shape[1]))) if known is None else known
        found, time = found.copy(), self.smoothed.log.time[self.points.step]
        for column, series in self.smoothed.series.items():
            if at_known is not None and np.array_equal(late[:, column], at_known[:, column]):
                continue
            for own, part in zip(self.points.stretches, series, strict=True):
                at = time[own] + late[own, column]
                for derivative in range(3):
                    found[own, derivative, column] = part.at(at, derivative)
        return found

    def lateness(self, reporting: Sequence[AtValues]) -> np.ndarray:
        """How late outputs are reported, s, (point, output)."""
        task, count = self.smoothed.task, len(self.points)
        late = np.zeros((count, len(task.outputs)))
        for effect, values in reporting:
            each = np.repeat(values[None], count, axis=0)
            own = np.zeros((count, task.model.nsensordata)) + effect.lateness(each, self.points.elapsed)
            late += own[:, [c.index for c in task.outputs]]
            late -= np.reshape(effect.drift(each, self.points.elapsed), (-1, 1))
        return late

    def unknown(self, late: np.ndarray) -> np.ndarray:
        """Where what is true is reported, `late` s after (point, output), before or after the stretch, (point,)."""
        found, time = np.zeros(len(self.points), dtype=bool), self.smoothed.log.time
        for own, part in zip(self.points.stretches, self.smoothed.parts, strict=True):
            at = self.points.since[own, None] + late[own]
            found[own] = ((at < 0) | (at > time[part.stop - 1] - time[part.start])).any(axis=1)
        return found

    def true(self, numbers: np.ndarray, reporting: Sequence[AtValues]) -> np.ndarray:
        """Outputs with slopes and curvatures as they truly are, (point, 3, output), of `numbers` as they are reported
        when that is in time. Of an effect that does not say what becomes of the curvature it is the slope of its slope.
        """
        task, count = self.smoothed.task, len(self.points)
        columns = [c.index for c in task.outputs]
        for effect, values in reversed(reporting):
            each = np.repeat(values[None], count, axis=0)
            before = numbers
            reported = np.zeros((count, 3, task.model.nsensordata))
            reported[..., columns] = before
            reported[:, 0] -= self._picked_up(effect, each)
            numbers = effect.true_motion(reported, each, self.points.elapsed)[..., columns]
            for told, found in ((0, 1), (1, 2)):
                moved = (numbers[:, told] != before[:, told]).any(axis=0)
                for column in np.flatnonzero(moved & (numbers[:, found] == before[:, found]).all(axis=0)):
                    numbers[:, found, column] += self.points.slope(
                        numbers[:, told, column] - before[:, told, column]
                    )
        return numbers

    def with_curvatures(
        self, numbers: np.ndarray, later: np.ndarray, accelerations: np.ndarray
    ) -> np.ndarray:
        """`numbers` (point, 3, output) with curvatures as of these `accelerations` (point, nv) of coordinates, each
        `later` by some s, (point, output).
        """
        numbers = numbers.copy()
        for source in self.smoothed.sources:
            if source.weights is not None:
                continue
            for column, dof in zip(source.columns, source.dofs, strict=True):
                if not later[:, column].any():
                    numbers[:, 2, column] = accelerations[:, dof]
                    continue
                for own in self.points.stretches:
                    at = self.points.since[own]
                    spline = CubicSpline(at, accelerations[own, dof])
                    numbers[own, 2, column] = spline(at + later[own, column])
        return numbers

    def _picked_up(self, effect: Effect, each: np.ndarray) -> np.ndarray:
        """What sensors show of the forces of actuators, behind the filter of the smoothed motion, (point, column)."""
        if not effect.reads_actuators:
            return np.zeros(self.smoothed.task.model.nsensordata)
        none = np.zeros((len(self.points), 1, self.smoothed.task.model.nsensordata))
        shown = effect.pick_up(none, each, self.actuator_force()[:, None])[:, 0]
        if not shown.any():
            return shown
        series = next(iter(self.smoothed.series.values()))
        for n, own in enumerate(self.points.stretches):
            at = self.smoothed.log.time[self.points.step[own]]
            shown[own] = series[n].filtered(shown[own], at)
        return shown
