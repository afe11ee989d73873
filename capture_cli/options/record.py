"""Options of `capture record`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

from capture_cli.options.base import UNRECORDED
from capture_cli.options.completion import effects, words
from capture_cli.options.shared import (
    LogOut,
    MaxLogSize,
    Robot,
    Simulating,
    Task,
    World,
    deviations,
    numbers,
    ranges,
)

Parameters = numbers("--param", "NAME=VALUE; others are nominal.")
Noise = deviations("--noise", "SD for all outputs, or OUTPUT=SD.")
Amplitude = numbers("--amplitude", "INPUT=PEAK of the multisine.")
Start = ranges("--start", "JOINT=POSITION or JOINT=LOW:HIGH.")
StartVelocity = ranges("--start-velocity", "JOINT=VELOCITY or LOW:HIGH.")


@dataclass(frozen=True, kw_only=True)
class RecordOptions(Simulating):
    """The truth is not in the provenance of the log."""

    unrecorded = (*UNRECORDED, "parameters", "effects", "estimate")

    task: Task
    out: LogOut
    world: World = "plant"
    robot: Robot = None
    parameters: Parameters = field(default_factory=dict)
    random_parameters: Annotated[bool, typer.Option(help="Draw the others at random.")] = False
    effects: Annotated[
        list[str],
        typer.Option(
            "--effect", help="NAME@SITE.PARAMETER=VALUE, or =LOW:HIGH, drawn from.", autocompletion=effects
        ),
    ] = ()
    estimate: Annotated[
        Path | None,
        typer.Option(help="Estimate or diagnosis directory, whose values and effects the machine has."),
    ] = None
    noise: Noise = 0.0
    episodes: Annotated[int, typer.Option(min=1, help="Number of episodes.")] = 1
    policy: Annotated[
        str | None,
        typer.Option(
            help="Who chooses the actions of a task that has some; default random.",
            autocompletion=words("random"),
        ),
    ] = None
    belief: Annotated[
        str,
        typer.Option(
            help="What the policy takes the parameters for: nominal, or random each time.",
            autocompletion=words("nominal", "random"),
        ),
    ] = "nominal"
    actions_from: Annotated[Path | None, typer.Option(help="Proposal whose action every episode takes.")] = (
        None
    )
    duration: Annotated[float | None, typer.Option(help="Seconds per episode; default 10.")] = None
    rate: Annotated[
        float | None, typer.Option(help="Samples per second; default the model's own, of actions 100.")
    ] = None
    inputs_from: Annotated[Path | None, typer.Option(help="Log, or proposal, whose inputs to replay.")] = None
    amplitude: Amplitude = field(default_factory=dict)
    band: Annotated[
        tuple[float, float],
        typer.Option(
            help="Lowest and highest Hz of the multisine; default --band 0.1 3.", show_default=False
        ),
    ] = (0.1, 3.0)
    start: Start = field(default_factory=dict)
    start_velocity: StartVelocity = field(default_factory=dict)
    truth: Annotated[Path | None, typer.Option(help="Where the truth goes; default OUT.truth.json.")] = None
    max_log_size: MaxLogSize = None
