"""`capture train-policy`: a task in, a policy that knows the parameters out (paper, III-B)."""

import time
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.common.extras import require
from capture_cli.common.frozen import frozen
from capture_cli.common.progress import Progress
from capture_cli.context.checkpoints.policy_checkpoint import read_policy, save_policy
from capture_cli.context.checkpoints.training_state import (
    STATE,
    check_made,
    kept,
    load_state,
    save_state,
    write_metrics,
)
from capture_cli.context.policies import REGISTRY
from capture_cli.context.policies._evaluation import evaluate, judge
from capture_cli.context.policies.base import Policy, Trainer, TrainingSettings
from capture_cli.context.torch_device import torch_device
from capture_cli.errors import OptionError
from capture_cli.model.effects.ranges import EffectRanges
from capture_cli.model.tasks.aimed_task import AimedTask, with_reward
from capture_cli.model.tasks.base import ActionTask, Task
from capture_cli.options.base import takes_options
from capture_cli.options.train_policy import TrainPolicyOptions
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.simulated_machine import SimulatedMachine
from capture_cli.store.output import is_complete, refuse_inputs, resumable_directory, unfinished
from capture_cli.store.provenance import Provenance


@frozen
class SETTINGS:
    evaluated: int = 200  # parameter sets of the evaluation curve, the same ones every time
    held_out: int = 500  # others, that the finished policy is judged on, and the random one
    tried: int = 64  # random episodes, before the training
    # of rewards, whose scale is 1
    same: float = 1e-9  # those that differ by less are one
    mirrored: float = 1e-3  # the mean difference of those of mirrored episodes


@takes_options
def train_policy(options: TrainPolicyOptions) -> dict[str, Any]:
    """Train the policy for the task; write its checkpoint directory at `out`; returns policy.json.

    With `resume` a run that was killed goes on from its last evaluation to the same result, and one that is complete is
    read. Raises CaptureError before anything is written.
    """
    require("learn", "train-policy")
    out, resume = options.out, options.resume
    complete = is_complete(out, force=options.force, resume=resume)
    asked = SimulatedMachine.to_learn_in(
        options.task,
        options.estimate,
        options.effects,
        why="a policy is trained for all values of the parameters",
    )
    machine = _trainable(asked.task)
    kind = _trained(options.policy)
    given = {f.name: getattr(options, f.name) for f in fields(TrainingSettings)}
    given["entropy"] = machine.entropy if options.entropy is None else options.entropy
    settings = TrainingSettings(**{**given, "device": torch_device(options.device, threads=1)})
    made = {
        "policy": options.policy,
        "task": machine.name,
        "effects": asked.effects.rows(),
        "training": asdict(settings),
    }
    if complete:
        document = read_policy(out, trained=True)
        check_made(document, made)
        return document
    refuse_inputs(out, [options.estimate])
    inputs = {"task": machine.path, "estimate": options.estimate}
    provenance = Provenance("train-policy", options.recorded(), inputs)
    simulator = Simulator(machine, asked.effects.placed, options.threads)
    machine.mirrored = machine.mirrored and _is_mirrored(simulator, asked.effects)
    recipe = {**made, "evaluations": options.evaluations}
    if isinstance(machine, AimedTask):
        _refuse_constant(simulator, asked.effects)
        recipe["reward"] = asdict(machine.aim)
    trainer = kind.trainer(simulator, settings, asked.effects)
    run = _Run(trainer, simulator, asked.effects, options.evaluations)
    if resume and (state := load_state(unfinished(out), recipe)) is not None:
        run.restore(*state)
    with resumable_directory(out, kept=kept, scaffold=[STATE], force=options.force, resume=resume) as folder:
        run.train(folder, recipe, options.quiet)
        with Progress("train-policy", "policy", quiet=options.quiet) as progress:
            progress.doing("judging the finished policy, and the random one")
            document = run.finish(options.policy, folder)
        provenance.write(folder)
    return document


# --- checks, before anything is written ---


def _trainable(machine: Task) -> ActionTask:
    machine = with_reward(machine)
    if not (isinstance(machine, ActionTask) and machine.trainable):
        raise OptionError(
            f"--task {machine.path or machine.name}: {machine.name!r} does not say what an episode is worth, so "
            "nothing can be learned",
            cure="write a [reward] into its task.toml; for histories of it no training is needed: "
            "`capture gen-histories --policy random`",
        )
    return machine


def _trained(name: str) -> type[Policy]:
    kind = REGISTRY.get(name)
    if not kind.trained:
        raise OptionError(
            f"--policy {name} learns nothing",
            cure=f"choose {', '.join(n for n, c in REGISTRY.items() if c.trained)}; "
            f"or give {name} to the command that needs a policy",
        )
    return kind


# --- the work ---


def _is_mirrored(simulator: Simulator, effects: EffectRanges) -> bool:
    """Whether a machine with the effects is worth in a mirror what it is worth without, as its task is: of the reward,
    whose scale is 1, a lag changes the mean by rounding there, a bias by much more than is allowed.
    """
    if not effects.placed:
        return True
    task = simulator.task
    points, uniform = _drawn(task, effects, np.random.default_rng(0), SETTINGS.tried)
    parameters, of_effects = np.split(points, [len(task.space)], axis=1)
    mirrored = np.concatenate([task.mirror_parameters(parameters), of_effects], axis=1)
    actions = task.draw_actions(uniform)
    sides = ((points, actions), (mirrored, task.mirror_actions(actions)))
    rewards = [judge(task, acted, *simulator.trajectories(under, acted))[0] for under, acted in sides]
    return float(np.abs(rewards[0] - rewards[1]).mean()) < SETTINGS.mirrored


def _refuse_constant(simulator: Simulator, effects: EffectRanges) -> None:
    """Raise OptionError where every random episode is worth the same: the inputs move no output with a goal."""
    task = simulator.task
    points, uniform = _drawn(task, effects, np.random.default_rng(0), SETTINGS.tried)
    rewards, _ = evaluate(REGISTRY.get("random")(task), simulator, points, uniform)
    if np.ptp(rewards) < SETTINGS.same:
        raise OptionError(
            f"--task {task.path}: each of {SETTINGS.tried} random episodes is worth {rewards[0]:.3g}, so nothing can "
            "be learned",
            cure="give [reward] goals for outputs that the inputs move, or a wider `within`",
        )


def _drawn(
    task: ActionTask, effects: EffectRanges, generator: np.random.Generator, episodes: int
) -> tuple[np.ndarray, np.ndarray]:
    """Points (episode, parameter) of task and effects, and the draws that a policy may use, (episode, action)."""
    parameters = task.space.from_unit(generator.random((episodes, len(task.space))))
    uniform = generator.random((episodes, len(task.actions)))
    return np.concatenate([parameters, effects.drawn(generator, episodes)], axis=1), uniform


class _Run:
    """A training and its evaluations: on sets of parameters that stay the same, drawn apart from the training's."""

    def __init__(self, trainer: Trainer, simulator: Simulator, effects: EffectRanges, evaluations: int):
        self.trainer = trainer
        self.simulator = simulator
        self.effects = effects
        batches = trainer.settings.batches
        self.every = max(1, batches // evaluations)  # batches
        self.metrics: list[dict[str, Any]] = []

    def restore(self, counters: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
        """Go on from a state that was saved."""
        self.metrics = counters["metrics"]
        self.trainer.restore(counters["trainer"], arrays)

    def train(self, folder: Path, recipe: Mapping[str, Any], quiet: bool) -> None:
        """Train to the end; metrics, and a state to go on from, are written into `folder` at every evaluation."""
        settings, batches = self.trainer.settings, self.trainer.settings.batches
        done, clock = self.trainer.step // settings.envs, time.monotonic()
        write_metrics(folder, self.metrics)
        seen: list[tuple[np.ndarray, np.ndarray]] = []
        with Progress("train-policy", "batch", quiet=quiet, total=batches - done) as progress:
            for batch in range(done + 1, batches + 1):
                seen.append(self.trainer.train())
                if batch % self.every == 0 or batch == batches:
                    progress.doing(f"judging the policy of episode {batch * settings.envs}")
                    self._evaluate(seen)
                    counters, arrays = self.trainer.state()
                    save_state(folder, {"trainer": counters, "metrics": self.metrics}, arrays, recipe)
                    write_metrics(folder, self.metrics)
                    seen = []
                rate = (batch - done) * settings.envs / (time.monotonic() - clock)
                left = (batches - batch) * settings.envs / rate
                progress.step(self._told(batch * settings.envs, rate, left))

    def finish(self, name: str, folder: Path) -> dict[str, Any]:
        """Write the policy, whose kind is `name`; returns policy.json."""
        from capture_cli.report.training import write_policy_figure

        policy = self.trainer.policy()
        result = self._result(policy)
        about = {"effects": self.effects.rows(), "training": asdict(self.trainer.settings), "result": result}
        document = save_policy(policy, name, folder, about)
        write_policy_figure(self.metrics, result, folder)
        return document

    def _result(self, policy: Policy) -> dict[str, Any]:
        """How the finished policy does on parameters that nothing has been judged on, and the random one."""
        random = REGISTRY.get("random")(self.simulator.task)
        return {
            "episodes": SETTINGS.held_out,
            **self._judged(policy, SETTINGS.held_out, purpose=1),
            "random": self._judged(random, SETTINGS.held_out, purpose=1),
        }

    def _evaluate(self, seen: list[tuple[np.ndarray, np.ndarray]]) -> None:
        rewards, successes = (np.concatenate(values) for values in zip(*seen, strict=True))
        self.metrics.append(
            {
                "step": self.trainer.step,
                "training_reward": float(rewards.mean()),
                "training_success": float(successes.mean()),
                **self._judged(self.trainer.policy(), SETTINGS.evaluated, purpose=0),
            }
        )

    def _judged(self, policy: Policy, episodes: int, purpose: int) -> dict[str, float]:
        key = np.random.SeedSequence(self.trainer.settings.seed, spawn_key=(purpose,))
        generator = np.random.default_rng(key)
        points, uniform = _drawn(self.simulator.task, self.effects, generator, episodes)
        rewards, successes = evaluate(policy, self.simulator, points, uniform)
        return {"reward": float(rewards.mean()), "success": float(successes.mean())}

    def _told(self, step: int, rate: float, left: float) -> str:
        settings = self.trainer.settings
        last = f", success {self.metrics[-1]['success']:.3f}" if self.metrics else ""
        return f"{step} of {settings.batches * settings.envs} episodes{last}, {rate:.0f}/s, {left:.0f} s left"
