"""Episodes of one action as a vectorised environment for stable-baselines3: one step is one batch of simulations."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from capture_cli.context.policies._evaluation import judge
from capture_cli.model.effects.ranges import NO_EFFECTS, EffectRanges
from capture_cli.simulate.simulator import Simulator


class EpisodeVecEnv(VecEnv):
    """`count` environments whose every episode is one step, all simulated in one call of the batch engine.

    Observation: the parameters' place in the unit cube, drawn anew for every episode. Action: [-1, 1] per component,
    the task's range. Reward: the task's. An episode that diverges is worth what the worst of its batch is.
    effects: the simulator's, whose values are drawn anew for every episode as well, and which nobody observes.
    """

    render_mode = None

    def __init__(self, simulator: Simulator, count: int, seed: int, effects: EffectRanges = NO_EFFECTS):
        self.simulator = simulator
        self.effects = effects
        self.task = simulator.task
        self.generator = np.random.default_rng(seed)
        self.rewards = np.zeros(count)  # of the last step
        self.successes = np.zeros(count, dtype=bool)
        super().__init__(
            count,
            spaces.Box(0.0, 1.0, (len(self.task.space),), np.float32),
            spaces.Box(-1.0, 1.0, (len(self.task.actions),), np.float32),
        )

    def reset(self):
        self.coordinates = self.generator.random((self.num_envs, len(self.task.space)), dtype=np.float32)
        return self.coordinates.copy()

    def step_async(self, actions):
        self._chosen = actions

    def step_wait(self):
        parameters = self.task.space.from_unit(self.coordinates)
        actions = self.task.actions.from_unit((np.asarray(self._chosen, dtype=float) + 1) / 2)
        points = np.concatenate([parameters, self.effects.drawn(self.generator, self.num_envs)], axis=1)
        trajectories, diverged = self.simulator.trajectories(points, actions)
        self.rewards, self.successes = judge(self.task, actions, trajectories, diverged)
        infos: list[dict[str, Any]] = [{"terminal_observation": before} for before in self.coordinates]
        return self.reset(), self.rewards.astype(np.float32), np.ones(self.num_envs, dtype=bool), infos

    # --- what stable-baselines3 asks of every VecEnv ---

    def close(self):
        pass

    def get_attr(self, attr_name, indices=None):
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name, value, indices=None):
        setattr(self, attr_name, value)

    def env_method(self, method_name, *method_args, indices=None, **method_kwargs):
        raise NotImplementedError("these environments have no methods of their own")

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * len(list(self._get_indices(indices)))
