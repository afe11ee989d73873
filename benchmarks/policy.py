"""How good the policies in runs/policies are, beside the random one, and how far apart domain randomisation leaves us.

Success: one episode under each of 500 parameter sets that nothing was trained or chosen on; the policy knows the
parameters. The trajectory difference of domain randomisation (sum over the points of the distance between the simulated
and the measured puck): 100 pairs per seed of a target and of parameters drawn at random, both uniform over the ranges,
both driven by the action that the policy chooses under the random ones, as a history has it; and, for comparison, by
the one that it chooses under the target.
"""

from __future__ import annotations

import numpy as np

from benchmarks import ROOT
from benchmarks.base import Benchmark, Figure, Result
from capture_cli.context.checkpoints.policy_checkpoint import load_policy
from capture_cli.context.policies import REGISTRY
from capture_cli.context.policies._evaluation import evaluate
from capture_cli.context.policies.base import Policy
from capture_cli.model.tasks import load_task
from capture_cli.simulate.simulator import Simulator

POLICIES = ROOT / "runs" / "policies"
EPISODES, PAIRS, SEEDS = 500, 100, (0, 1, 2)
PURPOSE = 2  # of the draws: trainings use others
OVER_RANDOM = 3.0
SCOOPED = 0.98
DIFFERENCE = (0.2, 0.45)  # m, the paper's


class PolicyQuality(Benchmark):
    summary = "the trained policies' success, and domain randomisation's trajectory difference under them"

    def run(self) -> Result:
        hockey, scooping = (_Trained(name) for name in ("air-hockey", "scooping"))
        found, random = hockey.success(), hockey.success(REGISTRY.get("random")(hockey.task))
        figures = [
            Figure(
                "success over that of the random policy, air-hockey",
                found / random,
                target=(OVER_RANDOM, None),
            ),
            Figure("  success", found),
            Figure("  success of the random policy", random),
            Figure("success, scooping", scooping.success(), target=(SCOOPED, None)),
            Figure("  success of the random policy", scooping.success(REGISTRY.get("random")(scooping.task))),
        ]
        details = {}
        for seed in SEEDS:
            by_guess, by_target = hockey.randomised(seed)
            name = f"difference of domain randomisation, air-hockey, seed {seed}"
            figures += [
                Figure(name, float(by_guess.mean()), "m", DIFFERENCE),
                Figure("  by the action chosen under the target", float(by_target.mean()), "m"),
            ]
            details[f"seed {seed}"] = {"quartiles": np.quantile(by_guess, [0.25, 0.5, 0.75]).tolist()}
        return Result(figures, {"difference": details})


class _Trained:
    """A task with its policy of runs/policies."""

    def __init__(self, name: str):
        self.task = load_task(name)
        self.policy = load_policy(str(POLICIES / name), self.task)
        self.simulator = Simulator(self.task)

    def success(self, policy: Policy | None = None) -> float:
        """Share of the episodes in which `policy`, or else the trained one, succeeds."""
        parameters, uniform = self._draw(0, EPISODES)
        _, successes = evaluate(policy or self.policy, self.simulator, parameters, uniform)
        return float(successes.mean())

    def randomised(self, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Trajectory differences (pair,), m, by actions chosen under the random parameters, and under the targets."""
        parameters, uniform = self._draw(seed, 2 * PAIRS)
        guesses, targets = parameters[:PAIRS], parameters[PAIRS:]
        actions = [self.policy.act(known, uniform[:PAIRS]) for known in (guesses, targets)]
        return tuple(self._difference(guesses, targets, a) for a in actions)

    def _difference(self, guesses: np.ndarray, targets: np.ndarray, actions: np.ndarray) -> np.ndarray:
        (simulated, _), (measured, _) = (self.simulator.trajectories(p, actions) for p in (guesses, targets))
        return np.linalg.norm(measured - simulated, axis=-1).sum(axis=1)

    def _draw(self, seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(PURPOSE,)))
        parameters = self.task.space.from_unit(generator.random((count, len(self.task.space))))
        return parameters, generator.random((count, len(self.task.actions)))
