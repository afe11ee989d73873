"""Options of `capture record`."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path

from capture_cli.options.base import UNRECORDED, option
from capture_cli.options.completion import effects
from capture_cli.options.shared import (
    DEVIATIONS,
    NUMBERS,
    RANGES,
    LogOut,
    MaxLogSize,
    Robot,
    Simulating,
    Task,
    World,
)


@dataclass(frozen=True, kw_only=True)
class RecordOptions(Simulating):
    """The truth is not in the provenance of the log."""

    unrecorded = (*UNRECORDED, "parameters", "effects", "estimate")

    task: Task
    out: LogOut
    world: World = "plant"
    robot: Robot = None
    parameters: Mapping[str, float] = option(
        {}, "NAME=VALUE; others are nominal.", name="--param", text=NUMBERS
    )
    random_parameters: bool = option(False, "Draw the others at random.")
    effects: list[str] = option(
        (), "NAME@SITE.PARAMETER=VALUE, or =LOW:HIGH, drawn from.", name="--effect", offers=effects
    )
    estimate: Path | None = option(
        None, "Estimate or diagnosis directory, whose values and effects the machine has."
    )
    noise: Mapping[str, float] | float = option(0.0, "SD for all outputs, or OUTPUT=SD.", text=DEVIATIONS)
    episodes: int = option(1, "Number of episodes.", min=1)
    policy: str | None = option(
        None, "Who chooses the actions of a task that has some; default random.", offers=("random",)
    )
    belief: str = option(
        "nominal",
        "What the policy takes the parameters for: nominal, or random each time.",
        one_of=("nominal", "random"),
    )
    actions_from: Path | None = option(None, "Proposal whose action every episode takes.")
    duration: float | None = option(None, "Seconds per episode; default 10.", within=(0, inf))
    rate: float | None = option(
        None, "Samples per second; default the model's own, of actions 100.", within=(0, inf)
    )
    inputs_from: Path | None = option(None, "Log, or proposal, whose inputs to replay.")
    amplitude: Mapping[str, float] = option({}, "INPUT=PEAK of the multisine.", text=NUMBERS)
    band: tuple[float, float] = option(
        (0.1, 3.0), "Lowest and highest Hz of the multisine; default --band 0.1 3.", show_default=False
    )
    start: Mapping[str, tuple[float, float]] = option({}, "JOINT=POSITION or JOINT=LOW:HIGH.", text=RANGES)
    start_velocity: Mapping[str, tuple[float, float]] = option({}, "JOINT=VELOCITY or LOW:HIGH.", text=RANGES)
    truth: Path | None = option(None, "Where the truth goes; default OUT.truth.json.")
    max_log_size: MaxLogSize = None
