"""A user's own machine with a reward: an action is a sequence of inputs, from the model's initial state."""

import numpy as np

from capture_cli.errors import TaskError
from capture_cli.model.parameters import ParameterSpace
from capture_cli.model.tasks.base import Task
from capture_cli.model.tasks.reward import Reward
from capture_cli.model.tasks.sequence_task import MachineTask, SequenceTask


class AimedTask(MachineTask):
    """`machine` over episodes that are worth what `reward` says.

    An action is each input at each point, between which it is interpolated, inside the actuator's ctrlrange. Raises
    TaskError where an input has none.
    """

    trainable = True

    def __init__(self, machine: Task, reward: Reward):
        ranges = np.array([_range(machine, channel) for channel in machine.inputs]).reshape(-1, 2)
        if not len(ranges):
            raise TaskError(f"{machine.path}: [reward] without [inputs]", cure="name an actuator as an input")
        super().__init__(machine)
        self.aim = reward
        start = np.concatenate([machine.model.qpos0, np.zeros(machine.model.nv + machine.model.na)])
        points = reward.point_times
        sequences = np.tile(ranges.T, (1, len(points)))
        library = np.concatenate([np.tile(start, (2, 1)), sequences], axis=1)
        near = {goal.output: goal.within for goal in reward.goals}
        self._whole = SequenceTask(machine, points, library, [near.get(c.name, 1.0) for c in machine.outputs])
        self._start = start
        self.actions = ParameterSpace(list(self._whole.actions)[len(start) :])
        self.features, self.point_times = self._whole.features, self._whole.point_times

    def episodes(self, actions):
        return self._whole.episodes(
            np.concatenate([np.tile(self._start, (len(actions), 1)), actions], axis=1)
        )

    def reward(self, actions, trajectories):
        return self.aim.worth(self._misses(trajectories))

    def success(self, actions, trajectories):
        """Whether every goal is hit, within what counts."""
        return (self._misses(trajectories) <= 1).all(axis=1)

    def _misses(self, trajectories: np.ndarray) -> np.ndarray:
        return self.aim.misses(trajectories, tuple(c.name for c in self.outputs), self.point_times)


def _range(machine: Task, channel) -> tuple[float, float]:
    """Of the actuator's control. Raises TaskError where the model does not limit it."""
    actuator = machine.model.actuator(channel.index)
    if not machine.model.actuator_ctrllimited[channel.index]:
        raise TaskError(
            f"{machine.path}: [reward], and the actuator {actuator.name!r} has no ctrlrange",
            cure="give the actuator a ctrlrange in the model: a policy explores all of it",
        )
    low, high = machine.model.actuator_ctrlrange[channel.index]
    return float(low), float(high)


def with_reward(machine: Task) -> Task:
    """`machine` as a task that a policy is trained for, where its task.toml has a [reward]; otherwise as it is."""
    reward = getattr(machine, "reward", None)
    return AimedTask(machine, reward) if isinstance(reward, Reward) else machine
