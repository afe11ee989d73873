"""What a policy is: parameters and uniform draws in, actions out (paper, Section III-B)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from capture_cli.model.effects.ranges import NO_EFFECTS, EffectRanges
from capture_cli.model.tasks.base import ActionTask
from capture_cli.simulate.simulator import Simulator


@dataclass(frozen=True)
class TrainingSettings:
    """How to train a policy.

    steps: episodes in all, rounded up to whole batches of `envs`, which are simulated at once. updates: gradient
    steps after each of these, on `batch` episodes. learning_rate: at the start; it falls linearly to 0. entropy: its
    weight beside the reward. width, layers: of the networks. device: as torch names it.
    """

    steps: int
    envs: int
    updates: int
    batch: int
    learning_rate: float
    entropy: float
    width: int
    layers: int
    seed: int
    device: str = "cpu"

    @property
    def batches(self) -> int:
        """Batches of episodes in all."""
        return -(-self.steps // self.envs)


class Trainer(ABC):
    """Trains a policy, batch by batch. Two trainers with the same arguments do the same, on the same machine.

    settings: as given. step: episodes so far.
    """

    settings: TrainingSettings
    step: int

    @abstractmethod
    def train(self) -> tuple[np.ndarray, np.ndarray]:
        """Simulate a batch of episodes and learn from it; returns their rewards and successes, both (episode,)."""

    @abstractmethod
    def policy(self) -> Policy:
        """The policy as it is now."""

    @abstractmethod
    def state(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Counters (JSON) and arrays, from which `restore` goes on as if nothing had happened."""

    @abstractmethod
    def restore(self, counters: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
        """Go on from a `state` of a trainer with the same settings."""


class Policy(ABC):
    """Chooses one action per episode, knowing the parameters. It is made for one task.

    A policy that was trained is kept as two things: `settings` (what JSON holds) and `weights` (arrays by name). A
    stage writes them to a checkpoint directory as `policy.json` and `policy.safetensors` and reads them back.
    trained: whether the policy has weights, and so can only come from a checkpoint. Training needs the extra `learn`.
    """

    summary: str
    trained = False

    def __init__(self, task: ActionTask):
        self.task = task

    @abstractmethod
    def act(self, parameters: np.ndarray, uniform: np.ndarray) -> np.ndarray:
        """Actions (n, action), inside `task.actions`, for episodes under parameters (n, parameter).

        uniform (n, action): draws from [0, 1), all the randomness there is; the same draws give the same actions,
        however many rows are asked for at once.
        """

    def state(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Settings and weights, from which `from_state` makes the policy again."""
        return {}, {}

    @classmethod
    def weight_shapes(
        cls, settings: Mapping[str, Any], weights: Mapping[str, np.ndarray], parameters: int, actions: int
    ) -> Mapping[str, tuple[int, ...]] | None:
        """Of the weights, by name, that a policy of these settings has from so many parameters to so many components
        of an action; None where that is not known. Sizes that nothing else says are those of `weights`.

        Raises ValueError for settings that `state` never gave.
        """
        return None

    @classmethod
    def from_state(
        cls, task: ActionTask, settings: Mapping[str, Any], weights: Mapping[str, np.ndarray]
    ) -> Policy:
        """The policy that `state` described."""
        return cls(task)

    @classmethod
    def trainer(
        cls, simulator: Simulator, settings: TrainingSettings, effects: EffectRanges = NO_EFFECTS
    ) -> Trainer:
        """Who trains such a policy for the simulator's task. Imports what that needs, torch and the like.

        effects: the simulator's, with the values between which each episode draws, and which the policy does not know.
        """
        raise NotImplementedError(f"{cls.__name__} is not trained")
