"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture_cli.cli._completion import effects, tasks, words
from capture_cli.cli._texts import byte_count

MOST_THREADS, MOST_STARTS = 1024, 10_000
LARGEST_SEED = 2**32 - 1  # that every generator of random numbers takes
_TASK = "Built-in task, or path of a task.toml."

Force = Annotated[bool, typer.Option("--force", help="Replace --out if it exists.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress, no tables.")]
TakenSeed = Annotated[
    int | None,
    typer.Option(
        "--seed",
        min=0,
        max=LARGEST_SEED,
        help="Seed of every random choice; default that of the estimate, or 0.",
    ),
]
Seed = Annotated[int, typer.Option("--seed", min=0, max=LARGEST_SEED, help="Seed of every random choice.")]
Threads = Annotated[
    int | None, typer.Option("--threads", min=1, max=MOST_THREADS, help="Threads; all cores by default.")
]
Task = Annotated[str, typer.Option("--task", help=_TASK, autocompletion=tasks)]
OptionalTask = Annotated[str | None, typer.Option("--task", help=_TASK, autocompletion=tasks)]
LogOut = Annotated[Path, typer.Option("--out", help="Measured log to write (.zarr).")]
RealLog = Annotated[Path, typer.Option("--real-log", help="Measured log (.zarr).")]
MaxLogSize = Annotated[
    int | None,
    typer.Option(
        "--max-log-size",
        parser=byte_count,
        metavar="SIZE",
        help="Most memory for a log, say 2GB; default 100MB, or 50 times what it takes on disk.",
    ),
]
Test = Annotated[
    str | None,
    typer.Option("--test", help="Recordings to hold out (names or patterns, comma-separated), or none."),
]
Window = Annotated[float | None, typer.Option("--window", help="Seconds between restarts of the state.")]
Starts = Annotated[
    int,
    typer.Option(
        "--starts",
        min=1,
        max=MOST_STARTS,
        help="Descents from different places; one, where a force balance says where.",
    ),
]
Result = Annotated[Path, typer.Argument(help="Estimate or diagnosis directory.")]
CheckpointOut = Annotated[Path, typer.Option("--out", help="Checkpoint directory to write.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on with a run that ended early.")]
ActionPolicy = Annotated[
    str,
    typer.Option(
        "--policy",
        help="Who chooses actions: random, or a checkpoint directory.",
        autocompletion=words("random"),
    ),
]
AddedEffect = Annotated[
    list[str],
    typer.Option(
        "--effect",
        help="NAME@SITE.PARAMETER=VALUE, or =LOW:HIGH, drawn anew each time; NAME@SITE alone: over its ranges.",
        autocompletion=effects,
    ),
]
AddedEstimate = Annotated[
    Path | None,
    typer.Option("--estimate", help="Diagnosis directory: what was found is in the simulated machine."),
]
ObservationNoise = Annotated[
    str,
    typer.Option(
        "--noise",
        help="On what is measured: none, scale or label, as in the paper.",
        autocompletion=words("none", "scale", "label"),
    ),
]
Device = Annotated[
    str,
    typer.Option(
        "--device",
        help="Of the networks: cpu, cuda, or auto: a GPU if there is one.",
        autocompletion=words("auto", "cpu", "cuda"),
    ),
]


def fail_on_option(what: str, names: tuple[str, ...]):
    """--fail-on, which may name these."""
    return typer.Option(
        "--fail-on", help=f"Exit with 3 on {what}: {', '.join(names)}.", autocompletion=words(*names)
    )
