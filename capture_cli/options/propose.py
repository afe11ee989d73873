"""Options of `capture propose`."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from capture_cli.options.base import Options, option
from capture_cli.options.shared import NUMBERS, Force, OptionalTask, Result, Seed, Threads


@dataclass(frozen=True, kw_only=True)
class ProposeOptions(Options):
    """out, csv: where the proposal, and its inputs, go."""

    result: Result
    task: OptionalTask = None
    policy: str | None = option(
        None, "Let this policy choose, rather than what tells most.", offers=("random",)
    )
    candidates: int = option(48, "Random actions that are compared.", min=1)
    amplitude: Mapping[str, float] = option(
        {}, "INPUT=VALUE, above 0: how far an input may be driven.", text=NUMBERS
    )
    beyond_log: bool = option(False, "Also multisines that take the model beyond what the log shows.")
    out: Path | None = option(None, "File to write; default stdout.")
    csv: Path | None = option(None, "Also the inputs, in the columns and units of the log.")
    seed: Seed = 0
    threads: Threads = None
    force: Force = False
