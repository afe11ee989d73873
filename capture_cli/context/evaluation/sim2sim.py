"""Identification of a simulator by a simulator (paper, Section IV-C): pairs of a source and a hidden target.

Every identifier meets the same pairs, the same draws of the policy and the same noise.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from capture_cli.context import observation_noise
from capture_cli.context.identifiers.base import (
    RoundIdentifier,
    Signature,
    Simulate,
    Walk,
    finite,
    run_rounds,
)
from capture_cli.context.policies.base import Policy
from capture_cli.context.worlds.world import World
from capture_cli.model.effects.placed import Placed
from capture_cli.model.effects.ranges import NO_EFFECTS, EffectRanges
from capture_cli.model.tasks.base import ActionTask
from capture_cli.simulate.simulator import Simulator

# (signature, start, simulate=, seed=) -> the identifier
Make = Callable[..., RoundIdentifier]


@dataclass(frozen=True)
class Sim2Sim:
    """`pairs` pairs of `task`, identified for `rounds` rounds.

    number: which of several draws of the pairs this is (a "seed" of the paper); the first pairs and rounds of a draw do
    not depend on how many there are. known_noise: identifiers are told which labels are random. effects: what the
    machines have beside the task's model, which nobody is told; where it has a range, each pair's draws from it. world:
    plays the machines where it is given, whose effects are its own.
    """

    task: ActionTask
    policy: Policy
    pairs: int
    rounds: int
    noise: str = "none"
    seed: int = 0
    number: int = 0
    threads: int | None = None
    known_noise: bool = False
    effects: EffectRanges = NO_EFFECTS
    world: World | None = None

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Sources and targets, both (pair, parameter)."""
        size = len(self.task.space)
        drawn = np.array([self._generator(pair, 0).random((2, size)) for pair in range(self.pairs)])
        return self.task.space.from_unit(drawn[:, 0]), self.task.space.from_unit(drawn[:, 1])

    def run(
        self,
        make: Make,
        on_round: Callable[[int], None] | None = None,
        known: Sequence[tuple[Placed, np.ndarray]] = (),
    ) -> dict[str, np.ndarray]:
        """What the identifier that `make` makes does, by the names of the evaluation store: (pair, round, ...).

        known: effects with values (parameter,) that it simulates with.
        """
        source, target = self.ends()
        signature = Signature.of(self.task)
        simulate = Simulator(self.task.with_effects(known), threads=self.threads).trajectories
        machine = self.machine()
        of_effects = [self.effects.drawn(self._generator(pair, 3), 1) for pair in range(self.pairs)]
        truth = np.concatenate([target, np.concatenate(of_effects)], axis=1)
        told = {"error_rate": observation_noise.error_rate(self.noise)} if self.known_noise else {}
        seed = int(np.random.SeedSequence([self.seed, self.number]).generate_state(1)[0])
        identifier = make(signature, source, simulate=simulate, seed=seed, **told)
        uniform = self._uniform()
        noise = [self._generator(pair, 2) for pair in range(self.pairs)]
        measured = np.zeros((self.pairs, self.rounds, *signature.trajectory_shape))

        def act(number: int, parameters: np.ndarray) -> np.ndarray:
            return self.policy.act(parameters, uniform[:, number])

        def play(pairs: np.ndarray | slice, actions: np.ndarray) -> np.ndarray:
            return finite(*machine(truth[pairs], actions))

        def measure(number: int, actions: np.ndarray) -> np.ndarray:
            measured[:, number] = play(slice(None), actions)
            return observation_noise.apply(self.noise, measured[:, number, None], noise, number)[:, 0]

        walk = run_rounds(
            identifier, self.rounds, act=act, simulate=simulate, measure=measure, on_round=on_round
        )
        estimates = np.concatenate([source[:, None], walk.estimates], axis=1)
        actions, simulated, measured = self._judged(walk, estimates, measured, uniform, simulate, play)
        distance = np.linalg.norm(simulated - measured, axis=-1).sum(axis=-1)
        arrays = {
            "estimates": estimates,
            "sd": _with_first(walk.sd, estimates),
            "trajectory_difference": distance,
            "simulated_rollouts": np.pad(walk.simulated_rollouts, ((0, 0), (1, 0))),
        }
        if self.task.trainable:
            flat = (a.reshape(-1, *a.shape[2:]) for a in (actions, measured))
            arrays["success"] = self.task.success(*flat).reshape(distance.shape)
        return arrays

    def machine(self) -> Simulate:
        """What stands in for the real machine; its parameters are the task's, and its effects'."""
        if self.world is not None:
            return self.world.trajectories
        return Simulator(self.task, self.effects.placed, self.threads).trajectories

    def _judged(self, walk: Walk, estimates, measured, uniform, simulate: Simulate, play: Callable):
        """Action, simulated and measured trajectory of every estimate (pair, round, ...), without noise.

        The estimate after some rounds is what most identifiers ask for in the next: then these are that round's.
        play(pairs, actions) -> measured.
        """
        rounds = walk.rounds
        asked = np.concatenate([rounds.parameters, np.full_like(estimates[:, :1], np.nan)], axis=1)
        actions, simulated, measured = (
            np.concatenate([a, np.zeros_like(a[:, :1])], axis=1)
            for a in (rounds.actions, rounds.simulated, measured)
        )
        pair, number = np.nonzero((asked != estimates).any(axis=-1))
        parameters = estimates[pair, number]
        chosen = self.policy.act(parameters, uniform[pair, number])
        actions[pair, number] = chosen
        simulated[pair, number] = finite(*simulate(parameters, chosen))
        measured[pair, number] = play(pair, chosen)
        return actions, simulated, measured

    def _uniform(self) -> np.ndarray:
        """What the policy draws, (pair, round, action), and once more for the last estimate."""
        shape = (self.rounds + 1, len(self.task.actions))
        return np.array([self._generator(pair, 1).random(shape) for pair in range(self.pairs)])

    def _generator(self, pair: int, use: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, self.number, use, pair])


def _with_first(sd: np.ndarray | None, estimates: np.ndarray) -> np.ndarray:
    """Like `estimates`, NaN where nothing is known: always of the source."""
    result = np.full_like(estimates, np.nan)
    if sd is not None:
        result[:, 1:] = sd
    return result
