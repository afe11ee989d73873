"""`capture eval-sim2sim`: its options, and what it prints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture_cli.cli._completion import effects, identifiers, tasks, words
from capture_cli.cli._config import Config
from capture_cli.cli._options import (
    ActionPolicy,
    Force,
    Json,
    ObservationNoise,
    Quiet,
    Resume,
    Seed,
    Threads,
)
from capture_cli.cli._results import console, print_json


def eval_sim2sim(
    out: Annotated[Path, typer.Option("--out", help="Evaluation directory to write.")],
    identifier: Annotated[
        list[str],
        typer.Option(
            "--identifier",
            help="A name, a checkpoint directory, or NAME=DIRECTORY.",
            autocompletion=identifiers,
        ),
    ],
    task: Annotated[
        str | None, typer.Option("--task", help="Built-in task with actions.", autocompletion=tasks)
    ] = None,
    policy: ActionPolicy = "random",
    suite: Annotated[
        str | None,
        typer.Option(
            "--suite",
            help="paper: all its comparisons; --identifier and --policy take folders of checkpoints.",
            autocompletion=words("paper"),
        ),
    ] = None,
    cell: Annotated[
        list[str] | None,
        typer.Option("--cell", help="Of the suite, this comparison alone; may be given several times."),
    ] = None,
    effect: Annotated[
        list[str],
        typer.Option(
            "--effect",
            help="What the machines have beside the model: NAME@SITE.PARAMETER=VALUE, or =LOW:HIGH for each pair.",
            autocompletion=effects,
        ),
    ] = [],  # noqa: B006
    pairs: Annotated[
        int, typer.Option("--pairs", min=1, help="Pairs of a source and a hidden target.")
    ] = 100,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Times that the pairs are drawn.")] = 3,
    rounds: Annotated[int, typer.Option("--rounds", min=1, help="Rounds, one measured rollout each.")] = 30,
    noise: ObservationNoise = "none",
    known_noise: Annotated[
        bool, typer.Option("--known-noise", help="Tell identifiers which labels are random.")
    ] = False,
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    resume: Resume = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Evaluate identifiers on simulated truths: errors, success and cost by round, the paper's numbers beside.

    Example: capture eval-sim2sim --task air-hockey --identifier runs/capture --out evaluation
    """
    from capture_cli.stages.eval_sim2sim import eval_sim2sim as stage

    document = stage(
        suite=suite,
        cells=cell or [],
        noise=noise,
        effects=effect,
        known_noise=known_noise,
        task=task,
        identifiers=identifier,
        out=out,
        policy=policy,
        pairs=pairs,
        seeds=seeds,
        rounds=rounds,
        seed=seed,
        threads=threads,
        force=force,
        resume=resume,
        quiet=quiet,
    )
    if json_:
        print_json(document)
    elif not quiet:
        from capture_cli.report.evaluation_tables import print_evaluation, print_suite

        show = print_suite if suite else print_evaluation
        show(document, console(), out)
