"""What an episode of a user's own machine is worth, as `[reward]` of a task.toml says it."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Goal:
    """An output is to be at `target`, in its unit, at the time `at`, s; all the while where that is None.

    within: how near counts, in the output's unit. weight: beside other goals.
    """

    output: str
    target: float
    within: float
    at: float | None = None
    weight: float = 1.0


@dataclass(frozen=True)
class Reward:
    """goals: of an episode of `duration` s, in which every input is set at `points` points, evenly spread."""

    goals: tuple[Goal, ...]
    duration: float
    points: int

    @property
    def point_times(self) -> np.ndarray:
        """(point,), s: where inputs are set and outputs read; times of goals are among them."""
        ats = [goal.at for goal in self.goals if goal.at is not None]
        return np.unique(np.concatenate([np.linspace(0, self.duration, self.points), ats]))

    def misses(
        self, trajectories: np.ndarray, outputs: tuple[str, ...], point_times: np.ndarray
    ) -> np.ndarray:
        """By how many times `within` each goal is missed, (episode, goal); of one at all times, on average.

        trajectories (episode, point, output), read at point_times (point,).
        """
        missed = []
        for goal in self.goals:
            off = np.abs(trajectories[..., outputs.index(goal.output)] - goal.target) / goal.within
            # where an episode begins is no merit of it
            missed.append(
                off[:, 1:].mean(axis=1) if goal.at is None else off[:, _nearest(point_times, goal.at)]
            )
        return np.stack(missed, axis=1)

    def worth(self, missed: np.ndarray) -> np.ndarray:
        """Of an episode (episode,), from `misses`: 1 where all goals are hit, and of each a half at `within`."""
        weights = np.array([goal.weight for goal in self.goals])
        return (weights / (1 + missed)).sum(axis=1) / weights.sum()


def _nearest(times: np.ndarray, at: float) -> int:
    return int(np.argmin(np.abs(times - at)))
