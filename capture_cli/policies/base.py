"""What a policy is: parameters and uniform draws in, actions out (paper, Section III-B)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np

from capture_cli.tasks.base import ActionTask


class Policy(ABC):
    """Chooses one action per episode, knowing the parameters. It is made for one task.

    A policy that was trained is kept as two things: `settings` (what JSON holds) and `weights` (arrays by name). A
    stage writes them to a checkpoint directory as `policy.json` and `policy.safetensors` and reads them back.
    trained: whether the policy has weights, and so can only come from a checkpoint.
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
    def from_state(
        cls, task: ActionTask, settings: Mapping[str, Any], weights: Mapping[str, np.ndarray]
    ) -> Policy:
        """The policy that `state` described."""
        return cls(task)
