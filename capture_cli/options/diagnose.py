"""Options of `capture diagnose`."""

from dataclasses import dataclass
from pathlib import Path

from capture_cli.options.base import option
from capture_cli.options.shared import FittingLog, failing


@dataclass(frozen=True, kw_only=True)
class DiagnoseOptions(FittingLog):
    """estimate: of the same log, whose task, windows, held-out part and seed stand where they are None."""

    ending = ".diagnosis"

    estimate: Path | None = option(None, "Estimate directory of the same log.")
    out: Path | None = option(
        None, "Diagnosis directory; default NAME.diagnosis in the current folder, for NAME.zarr."
    )
    test: str | None = option(None, "Recordings to hold out; default those of the estimate.")
    most_effects: int = option(
        6, "Stop when so many effects are found; one at several places at once counts as one.", min=1
    )
    expression: bool = option(
        True, "Whether to look for a formula of what no effect explains.", name="--expression/--no-expression"
    )
    time_limit: float | None = option(
        None,
        "Seconds until all but the report is done, with the best so far; the result says what is left out.",
        min=0,
        max=1e7,
    )
    fail_on: frozenset[str] = failing("these verdicts", "unexplained", "effect-found", "tied")
