"""How good a policy is: the rewards and successes of its episodes."""

import numpy as np

from capture_cli.context.policies.base import Policy
from capture_cli.errors import FitError
from capture_cli.model.tasks.base import ActionTask
from capture_cli.simulate.simulator import Simulator


def evaluate(
    policy: Policy, simulator: Simulator, points: np.ndarray, uniform: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rewards and successes, both (episode,), of one episode under each of points (episode, parameter).

    points: parameters of the task, which the policy knows, and then of the simulator's effects. uniform (episode,
    action): the draws that the policy may use. Raises FitError where all diverge.
    """
    actions = policy.act(points[:, : len(policy.task.space)], uniform)
    return judge(policy.task, actions, *simulator.trajectories(points, actions))


def judge(
    task: ActionTask, actions: np.ndarray, trajectories: np.ndarray, diverged: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rewards and successes, both (episode,); an episode that diverged fails, and is worth what the worst other is.

    Raises FitError where all diverged.
    """
    rewards = task.reward(actions, trajectories)
    bad = diverged | ~np.isfinite(rewards)
    if bad.all():
        raise FitError(
            f"task {task.name!r}: all of {len(rewards)} episodes diverged in the simulator",
            cure="narrow the parameters' bounds or the actions' ranges, or use a smaller model timestep",
        )
    return np.where(bad, rewards[~bad].min(), rewards), task.success(actions, trajectories) & ~bad
