"""Points along a smoothed log, at which forces are worked out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from capture_cli.common.frozen import frozen
from capture_cli.estimate.balance.motion import SmoothedLog, runs


@frozen
class SETTINGS:
    """none: standard deviations of a velocity, below which it may be none. resting: half periods of the fastest motion
    that is smoothed, for which it is then at rest: a turning point is shorter.
    """

    none: float = 3.0
    resting: float = 2.0


@dataclass(frozen=True)
class Points:
    """Where forces are worked out. part (point,): of which stretch; step (point,): of the log; time (point,): s, by
    the clock of simulations; since (point,): s, since the stretch began; elapsed (point,): s, since its episode did.
    stretches: the points of each, of which some may have none.
    """

    part: np.ndarray
    step: np.ndarray
    time: np.ndarray
    since: np.ndarray
    elapsed: np.ndarray
    stretches: list[slice]

    @classmethod
    def of(cls, smoothed: SmoothedLog) -> Points:
        steps = [smoothed.steps(n) for n in range(len(smoothed.parts))]
        part = np.repeat(np.arange(len(steps)), [len(s) for s in steps])
        step, time = np.concatenate(steps), smoothed.log.time
        first = np.array([p.start for p in smoothed.parts])
        since, elapsed = time[step] - time[first[part]], time[step] - time[smoothed.episode_start[part]]
        ends = np.cumsum([0, *(len(s) for s in steps)])
        stretches = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        return cls(part, step, time[step] - time[0], since, elapsed, stretches)

    def __len__(self) -> int:
        return len(self.step)

    @cached_property
    def interval(self) -> float:
        """s, between points."""
        same = np.diff(self.part) == 0
        return float(np.median(np.diff(self.time)[same]))

    def slope(self, series: np.ndarray) -> np.ndarray:
        """Derivative of a series (point,) over the time of each stretch."""
        slope = np.empty_like(series)
        for own in self.stretches:
            slope[own] = CubicSpline(self.since[own], series[own])(self.since[own], nu=1)
        return slope

    def at_rest(self, smoothed: SmoothedLog, velocity: np.ndarray) -> np.ndarray:
        """Where a coordinate is at rest for longer than a turn of the motion takes, (point, nv), of its velocity."""
        cutoff = max(s[0].cutoff for s in smoothed.series.values())
        shortest = max(int(np.ceil(SETTINGS.resting * np.pi / cutoff / self.interval)), 2)
        slow = np.abs(velocity) < SETTINGS.none * smoothed.sd(1)
        found = np.zeros_like(slow)
        for dof, own in enumerate(slow.T):
            for run in (r for stretch in self.stretches for r in runs(stretch, own)):
                found[run, dof] = run.stop - run.start >= shortest
        return found
