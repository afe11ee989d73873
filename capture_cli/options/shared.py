"""Options that several commands share: each spelled once, and classes of those that go together."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar

import typer

from capture_cli.options.base import Options, Text, described, option
from capture_cli.options.completion import effects, tasks
from capture_cli.options.texts import byte_count, chosen, named_numbers, named_ranges, standard_deviations

MOST_THREADS, MOST_STARTS = 1024, 10_000
LARGEST_SEED = 2**32 - 1  # that every generator of random numbers takes
_TASK = "Built-in task, or path of a task.toml."

Seed = Annotated[int, described("Seed of every random choice.", min=0, max=LARGEST_SEED)]
Threads = Annotated[int | None, described("Threads; all cores by default.", min=1, max=MOST_THREADS)]
Task = Annotated[str, described(_TASK, offers=tasks)]
OptionalTask = Annotated[str | None, described(_TASK, offers=tasks)]
LogOut = Annotated[Path, described("Measured log to write (.zarr).")]
RealLog = Annotated[Path, described("Measured log (.zarr).")]
MaxLogSize = Annotated[
    int | None,
    described(
        "Most memory for a log, say 2GB; default 100MB, or 50 times what it takes on disk.",
        parser=byte_count,
        metavar="SIZE",
    ),
]
Json = Annotated[bool, described("Print one JSON document on stdout.", name="--json")]
Result = Annotated[Path, typer.Argument(help="Estimate or diagnosis directory.")]
CheckpointOut = Annotated[Path, described("Checkpoint directory to write.")]
Force = Annotated[bool, described("Replace --out if it exists.")]
Resume = Annotated[bool, described("Go on with a run that ended early.")]
ActionPolicy = Annotated[
    str, described("Who chooses actions: random, or a checkpoint directory.", offers=("random",))
]
AddedEffects = Annotated[
    list[str],
    described(
        "NAME@SITE.PARAMETER=VALUE, or =LOW:HIGH, drawn anew each time; NAME@SITE alone: over its ranges.",
        name="--effect",
        offers=effects,
    ),
]
AddedEstimate = Annotated[
    Path | None, described("Diagnosis directory: what was found is in the simulated machine.")
]
World = Annotated[
    str,
    described(
        "plant, or robosuite (an extra): the whole scene and its robot.", one_of=("plant", "robosuite")
    ),
]
Robot = Annotated[
    str | None,
    described("Of --world robosuite; default Panda.", offers=("Panda", "UR5e", "Sawyer", "IIWA", "Kinova3")),
]
ObservationNoise = Annotated[
    str,
    described(
        "On what is measured: none, scale or label, as in the paper.", offers=("none", "scale", "label")
    ),
]
Device = Annotated[
    str,
    described("Of the networks: cpu, cuda, or auto: a GPU if there is one.", one_of=("auto", "cpu", "cuda")),
]


NUMBERS = Text(list[str], named_numbers)  # NAME=VALUE, repeated: a number by name
RANGES = Text(list[str], named_ranges)  # NAME=VALUE or NAME=LOW:HIGH, repeated: (low, high) by name
# SD, or NAME=SD, repeated: one standard deviation for all, or each by name
DEVIATIONS = Text(list[str], standard_deviations)


def failing(what: str, *names: str) -> Any:
    """--fail-on, which may name these."""
    text = Text(str | None, partial(chosen, names))
    return option(frozenset(), f"Exit with 3 on {what}: {', '.join(names)}.", offers=names, text=text)


@dataclass(frozen=True, kw_only=True)
class Writing(Options):
    """Of a command that writes something, and prints what it was."""

    force: Force = False
    json_: Json = False
    quiet: bool = option(False, "No progress, no tables.")


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
    window: float | None = option(None, "Seconds between restarts of the state.")
    starts: int = option(
        3, "Descents from several points; one, where a force balance gives it.", min=1, max=MOST_STARTS
    )
    seed: int | None = option(
        None, "Seed of every random choice; default that of the estimate, or 0.", min=0, max=LARGEST_SEED
    )
    max_log_size: MaxLogSize = None
    threads: Threads = None
    resume: Resume = False

    def __post_init__(self):
        super().__post_init__()
        if self.out is None:
            object.__setattr__(self, "out", Path(f"{self.real_log.stem}{self.ending}"))
