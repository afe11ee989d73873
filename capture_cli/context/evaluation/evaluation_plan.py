"""What one evaluation is asked to do, checked before any work."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from capture_cli.context import observation_noise
from capture_cli.context.checkpoints.checkpoint_hash import recorded_policy
from capture_cli.context.checkpoints.policy_checkpoint import is_checkpoint, load_policy, played
from capture_cli.context.evaluation.evaluated_identifier import Evaluated, load_evaluated, require_extras
from capture_cli.context.evaluation.sim2sim import Sim2Sim
from capture_cli.context.histories.action_library import library_hash, task_of_histories
from capture_cli.context.worlds.world import PLANT, ROBOSUITE, World, check_world
from capture_cli.context.worlds.world import SETTINGS as WORLD
from capture_cli.errors import OptionError, TaskError
from capture_cli.model.effects.ranges import NO_EFFECTS, EffectRanges
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.base import ActionTask
from capture_cli.options.eval_sim2sim import EvalSim2SimOptions


@dataclass(frozen=True)
class EvaluationPlan:
    """Identifiers, and draws of the pairs that each of them meets. attributes: of the evaluation store.

    inputs: the checkpoints that are read.
    """

    evaluated: list[Evaluated]
    draws: list[Sim2Sim]
    attributes: dict[str, Any]
    inputs: list[Path]

    @property
    def task(self) -> ActionTask:
        return self.draws[0].task

    @property
    def recipe(self) -> dict[str, Any]:
        """What tells this evaluation from others, JSON-able."""
        first = self.draws[0]
        return {"pairs": first.pairs, "seeds": len(self.draws), "rounds": first.rounds, **self.attributes}

    def parts(self) -> list[tuple[str, Evaluated, Sim2Sim]]:
        """Every identifier with every draw, and the name of the folder that its result is kept in."""
        return [(f"{k}-{draw.number}", e, draw) for k, e in enumerate(self.evaluated) for draw in self.draws]


def evaluation_plan(
    options: EvalSim2SimOptions, effects: EffectRanges = NO_EFFECTS, *, spelled_out: Sequence[str] = ()
) -> EvaluationPlan:
    """The plan of one evaluation for these options. effects: of the machines.

    spelled_out: as `load_evaluated` takes it. Raises CaptureError."""
    require_extras(options.identifiers)
    check_world(options.world, options.robot)
    noise, policy = options.noise, options.policy
    machine = _action_task(options.task, policy, options.histories)
    observation_noise.check(noise, [f.name for f in machine.features])
    chosen = load_policy(policy, machine)
    numbers = {} if options.fit_steps is None else {"fit_steps": options.fit_steps}
    evaluated = load_evaluated(options.identifiers, machine, spelled_out, numbers)
    if options.known_noise:
        observation_noise.error_rate(noise)
    world = _world(options, machine, effects)
    draws = [
        Sim2Sim(
            task=machine,
            policy=chosen,
            pairs=options.pairs,
            rounds=options.rounds,
            noise=noise,
            seed=options.seed,
            number=number,
            threads=options.threads,
            known_noise=options.known_noise,
            effects=effects,
            world=world,
        )
        for number in range(options.seeds)
    ]
    noise = f"{noise} (known)" if options.known_noise else noise
    inputs = [e.path for e in evaluated if e.path is not None]
    inputs += [Path(policy)] if is_checkpoint(policy) else []
    inputs += [options.histories] if options.histories is not None else []
    return EvaluationPlan(evaluated, draws, _attributes(draws[0], policy, noise, evaluated), inputs)


def _world(options: EvalSim2SimOptions, machine: ActionTask, effects: EffectRanges) -> World | None:
    """Where machines are played; None for the plant. Raises OptionError where the robot cannot play them."""
    if options.world == PLANT:
        return None
    if effects.placed:
        raise OptionError(
            f"--effect with --world {options.world}, which lacks nothing that could be added to it",
            cure="leave one of them out",
        )
    world = World(machine, options.robot or WORLD.robot)
    world.try_out()
    return world


def _action_task(name: str | None, policy: str, histories: Path | None) -> ActionTask:
    """The task with actions: of a task.toml those of its policy, or of the rounds of `histories`."""
    if name is None:
        raise OptionError("no --task", cure="name one, or run all with --suite paper")
    machine = played(load_task(name), policy)
    if isinstance(machine, ActionTask):
        if histories is not None:
            raise OptionError(
                f"--histories {histories}: {machine.name!r} has actions of its own, or those of its policy",
                cure="leave it out",
            )
        return machine
    if histories is None:
        raise TaskError(
            f"{name} has no actions of its own, which a round chooses",
            cure="give what identifiers were trained on, --histories DIR, or a policy that `train-policy` made for it",
        )
    return task_of_histories(machine, histories)


def _attributes(draw: Sim2Sim, policy: str, noise: str, evaluated: list[Evaluated]) -> dict:
    task, chooses = draw.task, recorded_policy(policy)
    return {
        "task": task.name,
        "parameters": task.space.ranges(),
        "features": [asdict(f) for f in task.features],
        "identifiers": [{"label": e.label, **e.facts} for e in evaluated],
        # one that was not trained draws from the library, where there is one
        "policy": chooses if chooses["sha256"] else {**chooses, "sha256": library_hash(task)},
        "effects": draw.effects.rows(),
        "world": PLANT if draw.world is None else ROBOSUITE,
        "robot": None if draw.world is None else draw.world.robot,
        "noise": noise,
        "seed": draw.seed,
    }
