"""Options of `capture identify`."""

from dataclasses import dataclass
from pathlib import Path

from capture_cli.options.base import option
from capture_cli.options.shared import FittingLog, failing


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions(FittingLog):
    """identifier: None is the one shipped for the task, or least squares. test: None is a share of the log. resume:
    with the estimate at `out`, whose task, identifier, test, window and seed stand where they are None.
    """

    ending = ".estimate"

    out: Path | None = option(
        None, "Estimate directory; default NAME.estimate in the current folder, for NAME.zarr."
    )
    identifier: str | None = option(
        None,
        "least-squares, cma-es, or a directory of train-sysid; default the task's own, or least-squares.",
        offers=("least-squares", "cma-es"),
    )
    test: str | None = option(None, "Recordings to hold out (names or patterns, comma-separated), or none.")
    rounds: int | None = option(
        None,
        "Most rounds: an episode each if the identifier is learned, else a batch of simulations each.",
        min=1,
    )
    fail_on: frozenset[str] = failing("these verdicts", "unexplained", "not-identifiable")
    resume: bool = option(False, "Take up the estimate at --out: its log has new episodes.")
