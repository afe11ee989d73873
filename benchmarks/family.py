"""How many logs the shipped identifiers take for unlike what they were trained on (`in_family` of estimate.json).

A log: eight episodes under parameters drawn at random, noise of 0.5 mm on air hockey, labels as they are on scooping.
The policy of the training acts, and believes in other parameters in each episode; or actions are random; or something
is otherwise than in training: the air-hockey table leans, or it is rougher than any that was seen.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks import ROOT
from benchmarks.base import Benchmark, Figure, Result
from capture_cli.context.checkpoints.identifier_checkpoint import load_identifier
from capture_cli.context.checkpoints.policy_checkpoint import load_policy
from capture_cli.context.identifiers.base import Rounds, finite
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.base import ActionTask
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.identification.chosen_identifier import shipped_for
from capture_cli.stages.identification.in_context import SETTINGS as IN_CONTEXT

EPISODES, SEED = 8, 20
NOISE = {"air-hockey": 5e-4, "scooping": 0.0}  # m; of a label
TILTS = (0.01, 0.025, 0.05)  # rad
ROUGH = 0.11  # sliding friction, of both halves; training had 0.03 to 0.07
MOST_ALARMS = 0.02


class FamilyTest(Benchmark):
    summary = "logs that shipped identifiers take for unlike what they were trained on"

    def run(self) -> Result:
        hockey, scooping = (Logs(name, self.logs) for name in ("air-hockey", "scooping"))
        alarms = (None, MOST_ALARMS)
        figures = [
            Figure("logs as in training taken for others, air-hockey", hockey.outside(), target=alarms),
            Figure("logs as in training taken for others, scooping", scooping.outside(), target=alarms),
            Figure("random actions, air-hockey", hockey.outside(policy="random")),
            Figure("random actions, scooping", scooping.outside(policy="random")),
            *(
                Figure(f"a table that leans by {tilt:g} rad", hockey.outside(change=_leaning(tilt)))
                for tilt in TILTS
            ),
            Figure(f"a table with a friction of {ROUGH:g}", hockey.outside(change=_rough)),
        ]
        return Result(figures, {"logs": self.logs, "episodes": EPISODES})


class Logs:
    """`count` logs of a built-in task."""

    def __init__(self, name: str, count: int):
        self.name, self.count = name, count
        self.family = load_identifier(shipped_for(name)).model.family

    def outside(
        self, policy: str | None = None, change: Callable[[ActionTask, np.ndarray], None] | None = None
    ) -> float:
        """The share taken for unlike the training.

        change: what is done to the task and the parameters (log, parameter).
        """
        task, generator = load_task(self.name), np.random.default_rng(SEED)
        truth = task.space.from_unit(generator.random((self.count, len(task.space))))
        if change is not None:
            change(task, truth)
        total = self.count * EPISODES
        belief = task.space.from_unit(generator.random((total, len(task.space))))
        chooser = load_policy(policy or str(ROOT / "runs" / "policies" / self.name), task)
        actions = chooser.act(belief, generator.random((total, len(task.actions))))
        simulated = finite(*Simulator(task).trajectories(np.repeat(truth, EPISODES, axis=0), actions))
        noise = np.full(len(task.features), NOISE[self.name])
        measured = simulated + noise * generator.standard_normal(simulated.shape)
        arrays = (belief, actions, simulated, measured)
        rounds = Rounds(*(a.reshape(self.count, EPISODES, *a.shape[1:]) for a in arrays))
        return float((self.family.with_noise(noise).share_beyond(rounds) < IN_CONTEXT.outside).mean())


def _leaning(angle: float) -> Callable[[ActionTask, np.ndarray], None]:
    """By `angle` rad towards one side."""

    def change(task: ActionTask, _: np.ndarray) -> None:
        gravity = float(np.linalg.norm(task.model.opt.gravity))
        task.model.opt.gravity[:] = gravity * np.array([0.0, np.sin(angle), -np.cos(angle)])

    return change


def _rough(task: ActionTask, truth: np.ndarray) -> None:
    for name in ("left_friction", "right_friction"):
        truth[:, task.space.names.index(name)] = ROUGH
