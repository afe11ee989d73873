"""Options that several commands share: each spelled once, and classes of those that go together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar

import typer

from capture_cli.options.base import Options, Text
from capture_cli.options.completion import effects, tasks, words
from capture_cli.options.texts import byte_count, chosen, named_numbers, named_ranges, standard_deviations

MOST_THREADS, MOST_STARTS = 1024, 10_000
LARGEST_SEED = 2**32 - 1  # that every generator of random numbers takes
_TASK = "Built-in task, or path of a task.toml."

TakenSeed = Annotated[
    int | None,
    typer.Option(
        min=0, max=LARGEST_SEED, help="Seed of every random choice; default that of the estimate, or 0."
    ),
]
Seed = Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Seed of every random choice.")]
Threads = Annotated[int | None, typer.Option(min=1, max=MOST_THREADS, help="Threads; all cores by default.")]
Task = Annotated[str, typer.Option(help=_TASK, autocompletion=tasks)]
OptionalTask = Annotated[str | None, typer.Option(help=_TASK, autocompletion=tasks)]
LogOut = Annotated[Path, typer.Option(help="Measured log to write (.zarr).")]
RealLog = Annotated[Path, typer.Option(help="Measured log (.zarr).")]
MaxLogSize = Annotated[
    int | None,
    typer.Option(
        parser=byte_count,
        metavar="SIZE",
        help="Most memory for a log, say 2GB; default 100MB, or 50 times what it takes on disk.",
    ),
]
Window = Annotated[float | None, typer.Option(help="Seconds between restarts of the state.")]
Starts = Annotated[
    int,
    typer.Option(
        min=1,
        max=MOST_STARTS,
        help="Descents from several points; one, where a force balance gives it.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]
Result = Annotated[Path, typer.Argument(help="Estimate or diagnosis directory.")]
CheckpointOut = Annotated[Path, typer.Option(help="Checkpoint directory to write.")]
Force = Annotated[bool, typer.Option(help="Replace --out if it exists.")]
Resume = Annotated[bool, typer.Option(help="Go on with a run that ended early.")]
ActionPolicy = Annotated[
    str,
    typer.Option(
        help="Who chooses actions: random, or a checkpoint directory.", autocompletion=words("random")
    ),
]
AddedEffects = Annotated[
    list[str],
    typer.Option(
        "--effect",
        help="NAME@SITE.PARAMETER=VALUE, or =LOW:HIGH, drawn anew each time; NAME@SITE alone: over its ranges.",
        autocompletion=effects,
    ),
]
AddedEstimate = Annotated[
    Path | None, typer.Option(help="Diagnosis directory: what was found is in the simulated machine.")
]
World = Annotated[
    str,
    typer.Option(
        help="plant, or robosuite (an extra): the whole scene and its robot.",
        autocompletion=words("plant", "robosuite"),
    ),
]
Robot = Annotated[
    str | None,
    typer.Option(
        help="Of --world robosuite; default Panda.",
        autocompletion=words("Panda", "UR5e", "Sawyer", "IIWA", "Kinova3"),
    ),
]
ObservationNoise = Annotated[
    str,
    typer.Option(
        help="On what is measured: none, scale or label, as in the paper.",
        autocompletion=words("none", "scale", "label"),
    ),
]
Device = Annotated[
    str,
    typer.Option(
        help="Of the networks: cpu, cuda, or auto: a GPU if there is one.",
        autocompletion=words("auto", "cpu", "cuda"),
    ),
]


def numbers(option: str, about: str) -> Any:
    """NAME=VALUE, repeated: a number by name."""
    return Annotated[Mapping[str, float], Text(list[str], named_numbers), typer.Option(option, help=about)]


def ranges(option: str, about: str) -> Any:
    """NAME=VALUE or NAME=LOW:HIGH, repeated: (low, high) by name."""
    return Annotated[
        Mapping[str, tuple[float, float]], Text(list[str], named_ranges), typer.Option(option, help=about)
    ]


def deviations(option: str, about: str) -> Any:
    """SD, or NAME=SD, repeated: one standard deviation for all, or each by name."""
    return Annotated[
        Mapping[str, float] | float, Text(list[str], standard_deviations), typer.Option(option, help=about)
    ]


def failing(what: str, *names: str) -> Any:
    """--fail-on, which may name these."""
    option = typer.Option(
        "--fail-on", help=f"Exit with 3 on {what}: {', '.join(names)}.", autocompletion=words(*names)
    )
    return Annotated[frozenset[str], Text(str | None, partial(chosen, names)), option]


@dataclass(frozen=True, kw_only=True)
class Writing(Options):
    """Of a command that writes something, and prints what it was."""

    force: Force = False
    json_: Json = False
    quiet: Annotated[bool, typer.Option(help="No progress, no tables.")] = False


@dataclass(frozen=True, kw_only=True)
class Simulating(Writing):
    """Of one that simulates machines at random."""

    seed: Seed = 0
    threads: Threads = None


@dataclass(frozen=True, kw_only=True)
class FittingLog(Writing):
    """Of one that fits a model to a log. out: called after the log unless it is given."""

    ending: ClassVar[str]  # of that name

    real_log: RealLog
    task: OptionalTask = None
    out: Path | None = None
    test: str | None = None
    window: Window = None
    starts: Starts = 3
    seed: TakenSeed = None
    max_log_size: MaxLogSize = None
    threads: Threads = None
    resume: Resume = False

    def __post_init__(self):
        if self.out is None:
            object.__setattr__(self, "out", Path(f"{self.real_log.stem}{self.ending}"))
