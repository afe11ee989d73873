"""A robosuite environment behind gymnasium's interface."""

from typing import Any

import gymnasium
import numpy as np

CAMERA = "frontview"  # of robosuite's arenas


class GymnasiumEnvironment(gymnasium.Env):
    """Observations of robot and objects in one vector; robosuite's end of an episode (its horizon) is a truncation.

    environment: a robosuite environment that was not stepped yet. render_mode: None or "rgb_array", which needs an
    environment with an offscreen renderer.
    """

    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012

    def __init__(self, environment, render_mode: str | None = None):
        self.environment = environment
        self.render_mode = render_mode
        self._parts = ("object-state", *(f"robot{i}_proprio-state" for i in range(len(environment.robots))))
        low, high = environment.action_spec
        self.action_space = gymnasium.spaces.Box(low.astype(np.float32), high.astype(np.float32))
        size = self._vector(environment.observation_spec()).size
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        super().reset(seed=seed)
        if seed is not None:
            self.environment.rng = np.random.default_rng(seed)
        return self._vector(self.environment.reset()), {}

    def step(self, action):
        observations, reward, done, information = self.environment.step(np.asarray(action, dtype=float))
        information["success"] = bool(self.environment._check_success())
        return self._vector(observations), float(reward), False, bool(done), information

    def render(self):
        if self.render_mode is None:
            return None
        sim = self.environment.sim
        return sim.render(width=640, height=480, camera_name=CAMERA)[::-1]

    def close(self):
        self.environment.close()

    def _vector(self, observations) -> np.ndarray:
        return np.concatenate([np.ravel(observations[name]) for name in self._parts])
