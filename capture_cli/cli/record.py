"""`capture record`: its options, and what it prints."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from capture_cli.cli._completion import effects, words
from capture_cli.cli._config import Config
from capture_cli.cli._options import Force, Json, LogOut, MaxLogSize, Quiet, Seed, Task, Threads
from capture_cli.cli._results import print_json
from capture_cli.cli._texts import named_numbers, named_ranges, standard_deviations


def record(
    task: Task,
    out: LogOut,
    world: Annotated[
        str,
        typer.Option(
            "--world",
            help="plant, or robosuite (an extra): the whole scene, driven by its robot.",
            autocompletion=words("plant", "robosuite"),
        ),
    ] = "plant",
    param: Annotated[list[str], typer.Option("--param", help="NAME=VALUE; others are nominal.")] = [],  # noqa: B006
    random_parameters: Annotated[
        bool, typer.Option("--random-parameters", help="Draw the others at random.")
    ] = False,
    effect: Annotated[
        list[str],
        typer.Option(
            "--effect",
            help="NAME@SITE.PARAMETER=VALUE, or =LOW:HIGH, drawn from.",
            autocompletion=effects,
        ),
    ] = [],  # noqa: B006
    estimate: Annotated[
        Path | None,
        typer.Option(
            "--estimate", help="Estimate or diagnosis directory, whose values and effects the machine has."
        ),
    ] = None,
    noise: Annotated[list[str], typer.Option("--noise", help="SD for all outputs, or OUTPUT=SD.")] = [],  # noqa: B006
    episodes: Annotated[int, typer.Option("--episodes", min=1, help="Number of episodes.")] = 1,
    policy: Annotated[
        str | None,
        typer.Option(
            "--policy",
            help="Who chooses the actions of a task that has some; default random.",
            autocompletion=words("random"),
        ),
    ] = None,
    belief: Annotated[
        str,
        typer.Option(
            "--belief",
            help="What the policy takes the parameters for: nominal, or random each time.",
            autocompletion=words("nominal", "random"),
        ),
    ] = "nominal",
    actions_from: Annotated[
        Path | None, typer.Option("--actions-from", help="Proposal whose action every episode takes.")
    ] = None,
    duration: Annotated[
        float | None, typer.Option("--duration", help="Seconds per episode; default 10.")
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option("--rate", help="Samples per second; default the model's own, of actions 100."),
    ] = None,
    inputs_from: Annotated[
        Path | None, typer.Option("--inputs-from", help="Log, or proposal, whose inputs to replay.")
    ] = None,
    amplitude: Annotated[list[str], typer.Option("--amplitude", help="INPUT=PEAK of the multisine.")] = [],  # noqa: B006
    band: Annotated[
        tuple[float, float],
        typer.Option(
            "--band", help="Lowest and highest Hz of the multisine; default --band 0.1 3.", show_default=False
        ),
    ] = (0.1, 3.0),
    start: Annotated[list[str], typer.Option("--start", help="JOINT=POSITION or JOINT=LOW:HIGH.")] = [],  # noqa: B006
    start_velocity: Annotated[
        list[str], typer.Option("--start-velocity", help="JOINT=VELOCITY or LOW:HIGH.")
    ] = [],  # noqa: B006
    truth: Annotated[
        Path | None, typer.Option("--truth", help="Where the truth goes; default OUT.truth.json.")
    ] = None,
    seed: Seed = 0,
    max_log_size: MaxLogSize = None,
    threads: Threads = None,
    force: Force = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Record a log from a simulated machine, with noise and effects of your choice.

    Example: capture record --task task.toml --effect coulomb-friction@x=3 --noise 0.0005 --out run.zarr
    """
    from capture_cli.stages.record import record as stage

    recording = stage(
        task=task,
        out=out,
        world=world,
        parameters=named_numbers(param, "--param"),
        random_parameters=random_parameters,
        effects=effect,
        estimate=estimate,
        noise=standard_deviations(noise, "--noise"),
        episodes=episodes,
        policy=policy,
        belief=belief,
        actions_from=actions_from,
        duration=duration,
        rate=rate,
        inputs_from=inputs_from,
        amplitude=named_numbers(amplitude, "--amplitude"),
        band=band,
        start=named_ranges(start, "--start"),
        start_velocity=named_ranges(start_velocity, "--start-velocity"),
        truth=truth,
        seed=seed,
        max_log_size=max_log_size,
        threads=threads,
        force=force,
    )
    for doubt in () if quiet else recording.doubts:
        print(f"warning: {doubt}", file=sys.stderr)
    if json_:
        print_json(recording.truth)
    elif not quiet:
        steps, count = len(recording.log.time), len(recording.log.episode_ends)
        of_episodes = f"{count} episode{'s' * (count > 1)}"
        print(f"{out}: {steps} steps in {of_episodes}; truth in {truth or out.with_suffix('.truth.json')}")
