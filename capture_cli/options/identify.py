"""Options of `capture identify`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from capture_cli.options.completion import words
from capture_cli.options.shared import FittingLog, failing

Verdicts = failing("these verdicts", "unexplained", "not-identifiable")


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions(FittingLog):
    """identifier: None is the one shipped for the task, or least squares. test: None is a share of the log. resume:
    with the estimate at `out`, whose task, identifier, test, window and seed stand where they are None.
    """

    ending = ".estimate"

    out: Annotated[
        Path | None,
        typer.Option(help="Estimate directory; default NAME.estimate in the current folder, for NAME.zarr."),
    ] = None
    identifier: Annotated[
        str | None,
        typer.Option(
            help="least-squares, cma-es, or a directory of train-sysid; default the task's own, or least-squares.",
            autocompletion=words("least-squares", "cma-es"),
        ),
    ] = None
    test: Annotated[
        str | None, typer.Option(help="Recordings to hold out (names or patterns, comma-separated), or none.")
    ] = None
    rounds: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Most rounds: an episode each if the identifier is learned, else a batch of simulations each.",
        ),
    ] = None
    fail_on: Verdicts = frozenset()
    resume: Annotated[bool, typer.Option(help="Take up the estimate at --out: its log has new episodes.")] = (
        False
    )
