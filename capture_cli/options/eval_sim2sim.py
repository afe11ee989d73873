"""Options of `capture eval-sim2sim`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from capture_cli.options.completion import effects, identifiers, tasks, words
from capture_cli.options.shared import ActionPolicy, ObservationNoise, Resume, Robot, Simulating, World


@dataclass(frozen=True, kw_only=True)
class EvalSim2SimOptions(Simulating):
    """Of one evaluation, or of those of a suite."""

    out: Annotated[Path, typer.Option(help="Evaluation directory to write.")]
    identifiers: Annotated[
        list[str],
        typer.Option(
            "--identifier",
            help="A name, a checkpoint directory, or NAME=DIRECTORY.",
            autocompletion=identifiers,
        ),
    ]
    task: Annotated[
        str | None,
        typer.Option(
            help="Built-in task with actions, or a task.toml with --histories or a policy.",
            autocompletion=tasks,
        ),
    ] = None
    policy: ActionPolicy = "random"
    world: World = "plant"
    robot: Robot = None
    suite: Annotated[
        str | None,
        typer.Option(
            help="paper: all its comparisons; --identifier and --policy take folders of checkpoints.",
            autocompletion=words("paper"),
        ),
    ] = None
    cells: Annotated[list[str], typer.Option("--cell", help="Of the suite, this comparison alone.")] = ()
    histories: Annotated[
        Path | None, typer.Option(help="Of a task.toml: histories whose actions rounds take, at random.")
    ] = None
    effects: Annotated[
        list[str],
        typer.Option(
            "--effect",
            help="What the machines have beside the model: NAME@SITE.PARAMETER=VALUE, or =LOW:HIGH for each pair.",
            autocompletion=effects,
        ),
    ] = ()
    pairs: Annotated[int, typer.Option(min=1, help="Pairs of a source and a hidden target.")] = 100
    seeds: Annotated[int, typer.Option(min=1, help="Times that the pairs are drawn.")] = 3
    rounds: Annotated[int, typer.Option(min=1, help="Rounds, one measured rollout each.")] = 30
    noise: ObservationNoise = "none"
    known_noise: Annotated[bool, typer.Option(help="Tell identifiers which labels are random.")] = False
    fit_steps: Annotated[
        int | None, typer.Option(min=1, help="Steps of compass's network each round; 1000 converge.")
    ] = None
    resume: Resume = False
