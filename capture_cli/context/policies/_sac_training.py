"""Training of an environment-conditioned SAC by stable-baselines3, with a state to go on from.

Episodes of one action are a vectorised environment, one step of which is one batch of simulations.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import SAC
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv

from capture_cli.common.named_arrays import by_part
from capture_cli.context.policies._evaluation import judge
from capture_cli.context.policies.base import Trainer, TrainingSettings
from capture_cli.context.policies.sac import Sac
from capture_cli.errors import FitError
from capture_cli.model.effects.ranges import NO_EFFECTS, EffectRanges
from capture_cli.simulate.simulator import Simulator

BUFFER = ("observations", "actions", "rewards")  # the rest of what the replay buffer holds follows from these


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


class SacTrainer(Trainer):
    """Episodes are one step long: the critic learns the reward itself, and nothing is discounted."""

    def __init__(self, simulator: Simulator, settings: TrainingSettings, effects: EffectRanges):
        self.settings = settings
        self.task = simulator.task
        self.env = EpisodeVecEnv(simulator, settings.envs, settings.seed, effects)
        warm_up = 0.02  # of the episodes, with random actions, before anything is learned
        self.sac = SAC(
            "MlpPolicy",
            self.env,
            learning_rate=lambda _: self._rate(),
            buffer_size=settings.batches * settings.envs,
            learning_starts=round(warm_up * settings.steps),
            batch_size=settings.batch,
            gamma=0.0,
            gradient_steps=settings.updates,
            ent_coef=settings.entropy,
            policy_kwargs={"net_arch": [settings.width] * settings.layers},
            seed=settings.seed,
            device=settings.device,
            verbose=0,
        )
        # of its own accord it makes a folder in the temporary directory at every call of `learn`
        self.sac.set_logger(Logger(folder=None, output_formats=[]))

    @property
    def step(self) -> int:
        return self.sac.num_timesteps

    def train(self):
        try:
            self.sac.learn(self.settings.envs, log_interval=None, reset_num_timesteps=False)
        except ValueError as error:  # torch's, of a distribution without a mean
            if all(bool(p.isfinite().all()) for p in self.sac.actor.parameters()):
                raise
            raise FitError(
                f"the training diverged after {self.step} episodes",
                cure=f"begin anew (--force) with a lower --lr than {self.settings.learning_rate:g}",
            ) from error
        return self.env.rewards, self.env.successes

    def policy(self):
        actor = self.sac.actor
        linear = [m for m in [*actor.latent_pi, actor.mu] if isinstance(m, torch.nn.Linear)]
        layers = [(_array(m.weight), _array(m.bias)) for m in linear]
        return Sac(self.task, layers)

    def _rate(self) -> float:
        """Falls linearly to 0, so that the actor settles."""
        sac = getattr(self, "sac", None)
        done = 0.0 if sac is None else sac.num_timesteps / (self.settings.batches * self.settings.envs)
        return self.settings.learning_rate * max(0.0, 1.0 - done)

    # --- state ---

    def state(self):
        sac, arrays = self.sac, {}
        for name, value in sac.policy.state_dict().items():
            arrays[f"policy.{name}"] = _array(value)
        for name, optimizer in self._optimizers().items():
            for number, values in optimizer.state_dict()["state"].items():
                arrays |= {f"{name}.{number}.{key}": _array(value) for key, value in values.items()}
        buffer = sac.replay_buffer
        filled = buffer.buffer_size if buffer.full else buffer.pos
        arrays |= {f"buffer.{name}": getattr(buffer, name)[:filled] for name in BUFFER}
        _, keys, *_ = np.random.get_state()  # noqa: NPY002
        arrays |= {"random.numpy": keys, "random.torch": torch.get_rng_state().numpy()}
        if sac.device.type == "cuda":
            arrays["random.device"] = torch.cuda.get_rng_state(sac.device).numpy()
        arrays["coordinates"] = self.env.coordinates
        return self._counters(), arrays

    def restore(self, counters, arrays):
        sac = self.sac
        parts = by_part(arrays)
        sac.policy.load_state_dict({name: torch.from_numpy(v.copy()) for name, v in parts["policy"].items()})
        for name, optimizer in self._optimizers().items():
            _load_optimizer(optimizer, parts.get(name, {}))
        self._refill(parts["buffer"])
        sac.num_timesteps, sac._n_updates = counters["step"], counters["updates"]
        self.env.coordinates = arrays["coordinates"].copy()
        sac._last_obs = self.env.coordinates.copy()
        self._restore_random(counters["random"], parts["random"])

    def _optimizers(self) -> dict[str, torch.optim.Optimizer]:
        return {"actor": self.sac.actor.optimizer, "critic": self.sac.critic.optimizer}

    def _counters(self) -> dict[str, Any]:
        kind, _, place, has_gauss, gauss = np.random.get_state()  # noqa: NPY002
        random = {
            "numpy": [kind, place, has_gauss, gauss],
            "env": self.env.generator.bit_generator.state,
            "actions": self.sac.action_space.np_random.bit_generator.state,
        }
        return {"step": self.step, "updates": self.sac._n_updates, "random": random}

    def _refill(self, values: Mapping[str, np.ndarray]) -> None:
        buffer = self.sac.replay_buffer
        filled = len(values["rewards"])
        for name in BUFFER:
            getattr(buffer, name)[:filled] = values[name]
        buffer.next_observations[:filled] = values["observations"]  # an episode's parameters do not change
        buffer.dones[:filled] = 1.0
        buffer.pos, buffer.full = filled % buffer.buffer_size, filled == buffer.buffer_size

    def _restore_random(self, counters: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
        kind, *rest = counters["numpy"]
        np.random.set_state((kind, arrays["numpy"], *rest))  # noqa: NPY002
        torch.set_rng_state(torch.from_numpy(arrays["torch"].copy()))
        if "device" in arrays and self.sac.device.type == "cuda":
            torch.cuda.set_rng_state(torch.from_numpy(arrays["device"].copy()), self.sac.device)
        self.env.generator.bit_generator.state = counters["env"]
        self.sac.action_space.np_random.bit_generator.state = counters["actions"]


def _array(tensor: torch.Tensor) -> np.ndarray:
    return tensor.detach().cpu().numpy().copy()


def _load_optimizer(optimizer: torch.optim.Optimizer, arrays: Mapping[str, np.ndarray]) -> None:
    """Arrays named NUMBER.KEY: what the optimizer keeps of each of its parameters."""
    kept = {
        int(number): {key: torch.from_numpy(array.copy()) for key, array in own.items()}
        for number, own in by_part(arrays).items()
    }
    optimizer.load_state_dict({**optimizer.state_dict(), "state": kept})
