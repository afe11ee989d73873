"""`capture gen-histories`: its options, and what it prints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture_cli.cli._completion import searches, words
from capture_cli.cli._config import Config
from capture_cli.cli._options import (
    ActionPolicy,
    AddedEffect,
    AddedEstimate,
    Force,
    Json,
    MaxLogSize,
    ObservationNoise,
    Quiet,
    Resume,
    Seed,
    Task,
    Threads,
)
from capture_cli.cli._results import print_json
from capture_cli.cli._texts import named_numbers, standard_deviations


def gen_histories(
    task: Task,
    out: Annotated[str, typer.Option("--out", help="Histories to write (.zarr): a path, or a URL.")],
    policy: ActionPolicy = "random",
    search: Annotated[
        str,
        typer.Option(
            "--search",
            help="Strategy: randomized-binary, binary, linear-interpolation or scattered.",
            autocompletion=searches,
        ),
    ] = "randomized-binary",
    pairs: Annotated[int, typer.Option("--pairs", min=1, help="Number of histories.")] = 1000,
    rounds: Annotated[int, typer.Option("--rounds", min=2, help="Entries of a history (the paper's L).")] = 7,
    alpha: Annotated[
        float | None, typer.Option("--alpha", help="Shape of the symmetric Beta; 5 by default.")
    ] = None,
    effect: AddedEffect = [],  # noqa: B006
    estimate: AddedEstimate = None,
    noise: ObservationNoise = "none",
    noise_sd: Annotated[
        list[str], typer.Option("--noise-sd", help="White noise besides: SD for all features, or FEATURE=SD.")
    ] = [],  # noqa: B006
    inputs_from: Annotated[
        Path | None, typer.Option("--inputs-from", help="For a task.toml: log whose windows are the actions.")
    ] = None,
    window: Annotated[
        float | None, typer.Option("--window", help="For a task.toml: seconds per episode.")
    ] = None,
    points: Annotated[
        int | None, typer.Option("--points", help="For a task.toml: points of a trajectory; 20 by default.")
    ] = None,
    amplitude: Annotated[
        list[str], typer.Option("--amplitude", help="For a task.toml: INPUT=PEAK of the multisines, above 0.")
    ] = [],  # noqa: B006
    band: Annotated[
        tuple[float, float] | None,
        typer.Option(
            "--band", help="For a task.toml: lowest and highest Hz of the multisines, say --band 0.1 3."
        ),
    ] = None,
    executor: Annotated[
        str,
        typer.Option(
            "--executor",
            help="Where to simulate: local, or ray (an extra) for a cluster.",
            autocompletion=words("local", "ray"),
        ),
    ] = "local",
    address: Annotated[
        str | None, typer.Option("--address", help="Address of the Ray cluster; one is started without.")
    ] = None,
    seed: Seed = 0,
    max_log_size: MaxLogSize = None,
    threads: Threads = None,
    force: Force = False,
    resume: Resume = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Generate adaptation histories: walks from random parameters to a target, with what both would show.

    Example: capture gen-histories --task air-hockey --pairs 1000 --out histories.zarr
    """
    from capture_cli.stages.gen_histories import gen_histories as stage

    document = stage(
        task=task,
        out=out,
        policy=policy,
        search=search,
        pairs=pairs,
        rounds=rounds,
        alpha=alpha,
        effects=effect,
        estimate=estimate,
        noise=noise,
        noise_sd=standard_deviations(noise_sd, "--noise-sd"),
        inputs_from=inputs_from,
        window=window,
        points=points,
        amplitude=named_numbers(amplitude, "--amplitude"),
        band=band,
        seed=seed,
        max_log_size=max_log_size,
        threads=threads,
        executor=executor,
        address=address,
        force=force,
        resume=resume,
        quiet=quiet,
    )
    if json_:
        print_json(document)
    elif not quiet:
        new = f"{document['shards_made']} of {document['shards']} shards are new"
        print(f"{out}: {document['pairs']} histories of {rounds} rounds; {new}")
