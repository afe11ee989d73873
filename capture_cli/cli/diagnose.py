"""`capture diagnose`: its options, and what it prints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture_cli.cli._config import Config
from capture_cli.cli._options import (
    Force,
    Json,
    MaxLogSize,
    OptionalTask,
    Quiet,
    RealLog,
    Resume,
    Starts,
    TakenSeed,
    Threads,
    Window,
    fail_on_option,
)
from capture_cli.cli._results import console, print_json
from capture_cli.cli._texts import chosen

VERDICTS = ("unexplained", "effect-found", "tied")  # that --fail-on may name


def diagnose(
    real_log: RealLog,
    estimate: Annotated[
        Path | None, typer.Option("--estimate", help="Estimate directory of the same log.")
    ] = None,
    task: OptionalTask = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", help="Diagnosis directory; default NAME.diagnosis in the current folder, for NAME.zarr."
        ),
    ] = None,
    test: Annotated[
        str | None, typer.Option("--test", help="Recordings to hold out; default those of the estimate.")
    ] = None,
    window: Window = None,
    starts: Starts = 3,
    most_effects: Annotated[
        int,
        typer.Option(
            "--most-effects",
            min=1,
            help="Stop when so many effects are found; one at several places at once counts as one.",
        ),
    ] = 6,
    expression: Annotated[
        bool,
        typer.Option(
            "--expression/--no-expression", help="Whether to look for a formula of what no effect explains."
        ),
    ] = True,
    time_limit: Annotated[
        float | None,
        typer.Option(
            "--time-limit",
            min=0,
            max=1e7,
            help="Seconds after which the search ends with the best so far, as a whole result that says so.",
        ),
    ] = None,
    fail_on: Annotated[str | None, fail_on_option("these verdicts", VERDICTS)] = None,
    seed: TakenSeed = None,
    max_log_size: MaxLogSize = None,
    threads: Threads = None,
    force: Force = False,
    resume: Resume = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Find what the model lacks, add it, and report the error before and after.

    Example: capture diagnose --real-log run.zarr --estimate run.estimate --out run.diagnosis
    """
    from capture_cli.stages.diagnose import diagnose as stage

    verdicts = chosen(fail_on, *VERDICTS)
    out = out or Path(f"{real_log.stem}.diagnosis")
    diagnosis = stage(
        real_log=real_log,
        out=out,
        estimate=estimate,
        task=task,
        test=test,
        window=window,
        starts=starts,
        most_effects=most_effects,
        expression=expression,
        time_limit=time_limit,
        seed=seed,
        max_log_size=max_log_size,
        threads=threads,
        force=force,
        resume=resume,
        quiet=quiet,
    )
    if json_:
        print_json(diagnosis.document)
    elif not quiet:
        from capture_cli.report.terminal import print_diagnosis

        print_diagnosis(diagnosis, console(), out)
    if diagnosis.document["verdict"] in verdicts:
        raise typer.Exit(3)
