"""`capture train-policy`: its options, and what it prints."""

from __future__ import annotations

from typing import Annotated

import typer

from capture_cli.cli._completion import tasks, words
from capture_cli.cli._config import Config
from capture_cli.cli._options import (
    AddedEffect,
    AddedEstimate,
    CheckpointOut,
    Device,
    Force,
    Json,
    Quiet,
    Seed,
    Threads,
)
from capture_cli.cli._results import console, print_json


def train_policy(
    task: Annotated[str, typer.Option("--task", help="Built-in task with a reward.", autocompletion=tasks)],
    out: CheckpointOut,
    policy: Annotated[
        str, typer.Option("--policy", help="What to train: sac.", autocompletion=words("sac"))
    ] = "sac",
    effect: AddedEffect = [],  # noqa: B006
    estimate: AddedEstimate = None,
    steps: Annotated[int, typer.Option("--steps", help="Episodes.")] = 150_000,
    envs: Annotated[int, typer.Option("--envs", help="Episodes simulated at once.")] = 64,
    updates: Annotated[int, typer.Option("--updates", help="Gradient steps after each of these.")] = 16,
    batch: Annotated[int, typer.Option("--batch", help="Episodes per gradient step.")] = 256,
    learning_rate: Annotated[
        float, typer.Option("--lr", help="Learning rate at the start; it falls linearly to 0.")
    ] = 1e-3,
    entropy: Annotated[
        float | None, typer.Option("--entropy", help="Weight of the entropy; the task's own by default.")
    ] = None,
    width: Annotated[int, typer.Option("--width", help="Width of the networks.")] = 64,
    layers: Annotated[int, typer.Option("--layers", help="Hidden layers of the networks.")] = 2,
    evaluations: Annotated[
        int, typer.Option("--evaluations", help="Points of the evaluation curve; what --resume goes on from.")
    ] = 30,
    device: Device = "cpu",
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a training that ended early.")] = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Train a policy that knows the parameters: for `gen-histories --policy`, where `random` needs no training.
    Needs the extra `learn`.

    Example: capture train-policy --task air-hockey --out runs/policy
    """
    from capture_cli.stages.train_policy import train_policy as stage

    document = stage(
        task=task,
        out=out,
        policy=policy,
        effects=effect,
        estimate=estimate,
        steps=steps,
        envs=envs,
        updates=updates,
        batch=batch,
        learning_rate=learning_rate,
        entropy=entropy,
        width=width,
        layers=layers,
        evaluations=evaluations,
        device=device,
        seed=seed,
        threads=threads,
        force=force,
        resume=resume,
        quiet=quiet,
    )
    if json_:
        print_json(document)
    elif not quiet:
        from capture_cli.report.training import print_policy

        print_policy(document, console(), out)
