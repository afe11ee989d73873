"""`capture identify`: its options, and what it prints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture_cli.cli._completion import words
from capture_cli.cli._config import Config
from capture_cli.cli._options import (
    Force,
    Json,
    MaxLogSize,
    OptionalTask,
    Quiet,
    RealLog,
    Starts,
    TakenSeed,
    Test,
    Threads,
    Window,
    fail_on_option,
)
from capture_cli.cli._results import console, print_json
from capture_cli.cli._texts import chosen

VERDICTS = ("unexplained", "not-identifiable")  # that --fail-on may name


def identify(
    real_log: RealLog,
    task: OptionalTask = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", help="Estimate directory; default NAME.estimate in the current folder, for NAME.zarr."
        ),
    ] = None,
    identifier: Annotated[
        str | None,
        typer.Option(
            "--identifier",
            help="least-squares, cma-es, or a directory of train-sysid; default the task's own, or least-squares.",
            autocompletion=words("least-squares", "cma-es"),
        ),
    ] = None,
    test: Test = None,
    window: Window = None,
    starts: Starts = 3,
    rounds: Annotated[
        int | None,
        typer.Option(
            "--rounds",
            min=1,
            help="Most rounds: an episode each if the identifier is learned, else a batch of simulations each.",
        ),
    ] = None,
    fail_on: Annotated[str | None, fail_on_option("these verdicts", VERDICTS)] = None,
    seed: TakenSeed = None,
    max_log_size: MaxLogSize = None,
    threads: Threads = None,
    force: Force = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Take up the estimate at --out: its log has new episodes.")
    ] = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Identify a model's parameters from a measured log.

    Example: capture identify --real-log run.zarr --task task.toml --out run.estimate
    """
    from capture_cli.stages.identify import identify as stage

    verdicts = chosen(fail_on, *VERDICTS)
    out = out or Path(f"{real_log.stem}.estimate")
    estimate = stage(
        real_log=real_log,
        out=out,
        task=task,
        identifier=identifier,
        test=test,
        window=window,
        starts=starts,
        rounds=rounds,
        seed=seed,
        max_log_size=max_log_size,
        threads=threads,
        resume=resume,
        force=force,
        quiet=quiet,
    )
    if json_:
        print_json(estimate.document)
    elif not quiet:
        from capture_cli.report.terminal import print_estimate

        print_estimate(estimate, console(), out)
    if estimate.document["verdict"] in verdicts:
        raise typer.Exit(3)
