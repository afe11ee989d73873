"""Options of `capture gen-histories`."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from capture_cli.options.base import option
from capture_cli.options.completion import searches
from capture_cli.options.shared import (
    DEVIATIONS,
    NUMBERS,
    ActionPolicy,
    AddedEffects,
    AddedEstimate,
    MaxLogSize,
    ObservationNoise,
    Resume,
    Simulating,
    Task,
)


@dataclass(frozen=True, kw_only=True)
class GenHistoriesOptions(Simulating):
    """shard_pairs: the unit of work, at most so much is lost when a run is killed."""

    task: Task
    out: str = option(..., "Histories to write (.zarr): a path, or a URL.")
    policy: ActionPolicy = "random"
    search: str = option(
        "randomized-binary",
        "Strategy: randomized-binary, binary, linear-interpolation or scattered.",
        offers=searches,
    )
    pairs: int = option(1000, "Number of histories.", min=1)
    rounds: int = option(7, "Entries of a history (the paper's L).", min=2)
    alpha: float | None = option(None, "Shape of the symmetric Beta; 5 by default.")
    effects: AddedEffects = ()
    estimate: AddedEstimate = None
    noise: ObservationNoise = "none"
    noise_sd: Mapping[str, float] | float = option(
        0.0, "White noise besides: SD for all features, or FEATURE=SD.", text=DEVIATIONS
    )
    inputs_from: Path | None = option(None, "For a task.toml: log whose windows are the actions.")
    window: float | None = option(None, "For a task.toml: seconds per episode.")
    points: int | None = option(None, "For a task.toml: points of a trajectory; 20 by default.", min=2)
    amplitude: Mapping[str, float] = option(
        {}, "For a task.toml: INPUT=PEAK of the multisines, above 0.", text=NUMBERS
    )
    band: tuple[float, float] | None = option(
        None, "For a task.toml: lowest and highest Hz of the multisines, say --band 0.1 3."
    )
    executor: str = option(
        "local", "Where to simulate: local, or ray (an extra) for a cluster.", one_of=("local", "ray")
    )
    address: str | None = option(None, "Address of the Ray cluster; one is started without.")
    max_log_size: MaxLogSize = None
    resume: Resume = False
    shard_pairs: int = 256
