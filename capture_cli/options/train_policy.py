"""Options of `capture train-policy`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from capture_cli.options.completion import tasks, words
from capture_cli.options.shared import AddedEffects, AddedEstimate, CheckpointOut, Device, Simulating


@dataclass(frozen=True, kw_only=True)
class TrainPolicyOptions(Simulating):
    """effects, estimate: what the simulated machine has that the task's model lacks; of a range, every episode draws,
    and the policy does not know what. threads: of the simulator; the learner has one.
    """

    task: Annotated[
        str, typer.Option(help="Built-in task with a reward, or a task.toml with one.", autocompletion=tasks)
    ]
    out: CheckpointOut
    policy: Annotated[str, typer.Option(help="What to train: sac.", autocompletion=words("sac"))] = "sac"
    effects: AddedEffects = ()
    estimate: AddedEstimate = None
    steps: Annotated[int, typer.Option(help="Episodes.")] = 150_000
    envs: Annotated[int, typer.Option(help="Episodes simulated at once.")] = 64
    updates: Annotated[int, typer.Option(help="Gradient steps after each of these.")] = 16
    batch: Annotated[int, typer.Option(help="Episodes per gradient step.")] = 256
    learning_rate: Annotated[
        float, typer.Option("--lr", help="Learning rate at the start; it falls linearly to 0.")
    ] = 1e-3
    entropy: Annotated[
        float | None, typer.Option(help="Weight of the entropy; the task's own by default.")
    ] = None
    width: Annotated[int, typer.Option(help="Width of the networks.")] = 64
    layers: Annotated[int, typer.Option(help="Hidden layers of the networks.")] = 2
    evaluations: Annotated[
        int, typer.Option(help="Points of the evaluation curve; what --resume goes on from.")
    ] = 30
    device: Device = "cpu"
    resume: Annotated[bool, typer.Option(help="Go on with a training that ended early.")] = False
