"""Options of `capture diagnose`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from capture_cli.options.shared import FittingLog, failing

Verdicts = failing("these verdicts", "unexplained", "effect-found", "tied")


@dataclass(frozen=True, kw_only=True)
class DiagnoseOptions(FittingLog):
    """estimate: of the same log, whose task, windows, held-out part and seed stand where they are None."""

    ending = ".diagnosis"

    estimate: Annotated[Path | None, typer.Option(help="Estimate directory of the same log.")] = None
    out: Annotated[
        Path | None,
        typer.Option(
            help="Diagnosis directory; default NAME.diagnosis in the current folder, for NAME.zarr."
        ),
    ] = None
    test: Annotated[
        str | None, typer.Option(help="Recordings to hold out; default those of the estimate.")
    ] = None
    most_effects: Annotated[
        int,
        typer.Option(
            min=1, help="Stop when so many effects are found; one at several places at once counts as one."
        ),
    ] = 6
    expression: Annotated[
        bool,
        typer.Option(
            "--expression/--no-expression", help="Whether to look for a formula of what no effect explains."
        ),
    ] = True
    time_limit: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=1e7,
            help="Seconds until all but the report is done, with the best so far; the result says what is left out.",
        ),
    ] = None
    fail_on: Verdicts = frozenset()
