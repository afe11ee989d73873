"""How a history is made (paper, Algorithm 1): task, policy, search, noise and seed give the histories of any pairs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.context import observation_noise
from capture_cli.context.policies.base import Policy
from capture_cli.context.search.base import Search
from capture_cli.errors import FitError
from capture_cli.model.effects.ranges import NO_EFFECTS, EffectRanges
from capture_cli.model.tasks.base import ActionTask
from capture_cli.simulate.simulator import Simulator


@frozen
class SETTINGS:
    attempts: int = 10  # at drawing a pair whose simulations do not diverge


Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class Recipe:
    """What histories are made from. Nothing else enters: a pair is the same in whatever company it is made.

    noise: one of `observation_noise.NOISES`. noise_sd (feature,): standard deviation of white noise besides. effects:
    what machines have beside the task's model; in simulated trajectories at the middle of its range.
    """

    task: ActionTask
    policy: Policy
    search: Search
    rounds: int
    noise: str
    noise_sd: tuple[float, ...]
    seed: int
    effects: EffectRanges = NO_EFFECTS

    def make(self, pairs: Sequence[int], threads: int | None = None) -> Arrays:
        """The histories of these pairs, by the names of the histories store.

        A pair with a simulation that diverges is drawn anew. Raises FitError where that does not help.
        """
        simulator = Simulator(self.task, self.effects.placed, threads)
        pairs = np.asarray(pairs)
        arrays, diverged = self._histories(pairs, 0, simulator)
        for attempt in range(1, SETTINGS.attempts):
            rows = np.flatnonzero(diverged)
            if not rows.size:
                return arrays
            again, diverged[rows] = self._histories(pairs[rows], attempt, simulator)
            for name, values in arrays.items():
                values[rows] = again[name]
        if diverged.any():
            raise FitError(
                f"task {self.task.name!r}: pair {pairs[diverged][0]} diverged in the simulator, drawn "
                f"{SETTINGS.attempts} times",
                cure="narrow the parameters' bounds, drive the machine less, or use a smaller model timestep",
            )
        return arrays

    def _histories(self, pairs: np.ndarray, attempt: int, simulator: Simulator) -> tuple[Arrays, np.ndarray]:
        """Histories of the pairs, and which of them diverged, (pair,)."""
        generators = [self._generator(int(pair), attempt) for pair in pairs]
        parameters, actions = self._walk(generators)
        target = parameters[:, -1]
        of_machines = np.stack([self.effects.drawn(g, 1)[0] for g in generators])
        # where machines have no effects of their own, the last round simulates the target itself: one simulation is
        # both trajectories
        shared = not self.effects.vary
        own = self.rounds - shared
        under = np.concatenate(
            [
                _with(parameters[:, :own], self.effects.middle),
                _with(np.repeat(target[:, None], self.rounds, axis=1), of_machines[:, None]),
            ],
            axis=1,
        )
        driven = np.concatenate([actions[:, :own], actions], axis=1)
        trajectories, diverged = _simulate(simulator, under, driven)
        simulated, measured = trajectories[:, :own], trajectories[:, own:]
        if shared:
            simulated = np.concatenate([simulated, measured[:, -1:]], axis=1)
        measured = observation_noise.apply(self.noise, measured, generators)
        if any(self.noise_sd):
            measured += self.noise_sd * np.stack([g.standard_normal(measured.shape[1:]) for g in generators])
        arrays = {
            "parameters": parameters,
            "actions": actions,
            "simulated": simulated,
            "measured": measured,
            "target": target.copy(),
        }
        return arrays, diverged

    def _generator(self, pair: int, attempt: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(pair, attempt)))

    def _walk(self, generators: Sequence[np.random.Generator]) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (pair, round, parameter) and actions (pair, round, action)."""
        space, actions = self.task.space, self.task.actions
        ends = np.stack([g.random((2, len(space))) for g in generators])
        steps = np.stack([g.random((self.rounds - 1, len(space))) for g in generators])
        choices = np.stack([g.random((self.rounds, len(actions))) for g in generators])
        source, target = (space.from_unit(ends[:, k]) for k in range(2))
        parameters = self.search.walk(source, target, space.low, space.high, steps)
        each = self.policy.act(parameters.reshape(-1, len(space)), choices.reshape(-1, len(actions)))
        # to single precision: matrix products of a policy's network may round their last bits by processor
        chosen = np.clip(np.float32(each).astype(float), actions.low, actions.high)
        return parameters, chosen.reshape(choices.shape)


def _with(parameters: np.ndarray, of_effects: np.ndarray) -> np.ndarray:
    """Parameters (pair, episode, parameter), and after them those of effects, (..., parameter)."""
    shape = (*parameters.shape[:2], of_effects.shape[-1])
    return np.concatenate([parameters, np.broadcast_to(of_effects, shape)], axis=2)


def _simulate(simulator: Simulator, parameters: np.ndarray, actions: np.ndarray):
    """Trajectories (pair, episode, point, feature) and which pairs diverged, (pair,).

    parameters (pair, episode, parameter), actions (pair, episode, action).
    """
    shape = parameters.shape[:2]
    parameters, actions = (a.reshape(shape[0] * shape[1], -1) for a in (parameters, actions))
    trajectories, diverged = simulator.trajectories(parameters, actions)
    diverged = diverged | ~np.isfinite(trajectories).all(axis=(1, 2))
    return trajectories.reshape(*shape, *trajectories.shape[1:]), diverged.reshape(shape).any(axis=1)
