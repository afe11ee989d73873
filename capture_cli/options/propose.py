"""Options of `capture propose`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

from capture_cli.options.base import Options
from capture_cli.options.completion import words
from capture_cli.options.shared import Force, OptionalTask, Result, Seed, Threads, numbers

Amplitude = numbers("--amplitude", "INPUT=VALUE, above 0: how far an input may be driven.")


@dataclass(frozen=True, kw_only=True)
class ProposeOptions(Options):
    """out, csv: where the proposal, and its inputs, go."""

    result: Result
    task: OptionalTask = None
    policy: Annotated[
        str | None,
        typer.Option(
            help="Let this policy choose, rather than what tells most.", autocompletion=words("random")
        ),
    ] = None
    candidates: Annotated[int, typer.Option(min=1, help="Random actions that are compared.")] = 48
    amplitude: Amplitude = field(default_factory=dict)
    beyond_log: Annotated[
        bool, typer.Option(help="Also multisines that take the model beyond what the log shows.")
    ] = False
    out: Annotated[Path | None, typer.Option(help="File to write; default stdout.")] = None
    csv: Annotated[
        Path | None, typer.Option(help="Also the inputs, in the columns and units of the log.")
    ] = None
    seed: Seed = 0
    threads: Threads = None
    force: Force = False
