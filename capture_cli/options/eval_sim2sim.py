"""Options of `capture eval-sim2sim`."""

from dataclasses import dataclass
from pathlib import Path

from capture_cli.options.base import option
from capture_cli.options.completion import effects, identifiers, tasks
from capture_cli.options.shared import ActionPolicy, ObservationNoise, Resume, Robot, Simulating, World


@dataclass(frozen=True, kw_only=True)
class EvalSim2SimOptions(Simulating):
    """Of one evaluation, or of those of a suite."""

    out: Path = option(..., "Evaluation directory to write.")
    identifiers: list[str] = option(
        ..., "A name, a checkpoint directory, or NAME=DIRECTORY.", name="--identifier", offers=identifiers
    )
    task: str | None = option(
        None, "Built-in task with actions, or a task.toml with --histories or a policy.", offers=tasks
    )
    policy: ActionPolicy = "random"
    world: World = "plant"
    robot: Robot = None
    suite: str | None = option(
        None,
        "paper: all its comparisons; --identifier and --policy take folders of checkpoints.",
        one_of=("paper",),
    )
    cells: list[str] = option((), "Of the suite, this comparison alone.", name="--cell")
    histories: Path | None = option(None, "Of a task.toml: histories whose actions rounds take, at random.")
    effects: list[str] = option(
        (),
        "What the machines have beside the model: NAME@SITE.PARAMETER=VALUE, or =LOW:HIGH for each pair.",
        name="--effect",
        offers=effects,
    )
    pairs: int = option(100, "Pairs of a source and a hidden target.", min=1)
    seeds: int = option(3, "Times that the pairs are drawn.", min=1)
    rounds: int = option(30, "Rounds, one measured rollout each.", min=1)
    noise: ObservationNoise = "none"
    known_noise: bool = option(False, "Tell identifiers which labels are random.")
    fit_steps: int | None = option(None, "Steps of compass's network each round; 1000 converge.", min=1)
    resume: Resume = False
