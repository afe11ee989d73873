"""Options of `capture gen-histories`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

from capture_cli.options.completion import searches, words
from capture_cli.options.shared import (
    ActionPolicy,
    AddedEffects,
    AddedEstimate,
    MaxLogSize,
    ObservationNoise,
    Resume,
    Simulating,
    Task,
    deviations,
    numbers,
)

Deviations = deviations("--noise-sd", "White noise besides: SD for all features, or FEATURE=SD.")
Amplitude = numbers("--amplitude", "For a task.toml: INPUT=PEAK of the multisines, above 0.")


@dataclass(frozen=True, kw_only=True)
class GenHistoriesOptions(Simulating):
    """shard_pairs: the unit of work, at most so much is lost when a run is killed."""

    task: Task
    out: Annotated[str, typer.Option(help="Histories to write (.zarr): a path, or a URL.")]
    policy: ActionPolicy = "random"
    search: Annotated[
        str,
        typer.Option(
            help="Strategy: randomized-binary, binary, linear-interpolation or scattered.",
            autocompletion=searches,
        ),
    ] = "randomized-binary"
    pairs: Annotated[int, typer.Option(min=1, help="Number of histories.")] = 1000
    rounds: Annotated[int, typer.Option(min=2, help="Entries of a history (the paper's L).")] = 7
    alpha: Annotated[float | None, typer.Option(help="Shape of the symmetric Beta; 5 by default.")] = None
    effects: AddedEffects = ()
    estimate: AddedEstimate = None
    noise: ObservationNoise = "none"
    noise_sd: Deviations = 0.0
    inputs_from: Annotated[
        Path | None, typer.Option(help="For a task.toml: log whose windows are the actions.")
    ] = None
    window: Annotated[float | None, typer.Option(help="For a task.toml: seconds per episode.")] = None
    points: Annotated[
        int | None, typer.Option(help="For a task.toml: points of a trajectory; 20 by default.")
    ] = None
    amplitude: Amplitude = field(default_factory=dict)
    band: Annotated[
        tuple[float, float] | None,
        typer.Option(help="For a task.toml: lowest and highest Hz of the multisines, say --band 0.1 3."),
    ] = None
    executor: Annotated[
        str,
        typer.Option(
            help="Where to simulate: local, or ray (an extra) for a cluster.",
            autocompletion=words("local", "ray"),
        ),
    ] = "local"
    address: Annotated[
        str | None, typer.Option(help="Address of the Ray cluster; one is started without.")
    ] = None
    max_log_size: MaxLogSize = None
    resume: Resume = False
    shard_pairs: int = 256
