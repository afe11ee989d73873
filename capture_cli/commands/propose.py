"""`capture propose`: its options, and what it prints."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from capture_cli.commands._completion import words
from capture_cli.commands._config import Config
from capture_cli.commands._options import Force, OptionalTask, Result, Seed, Threads
from capture_cli.commands._results import print_json
from capture_cli.commands._texts import named_numbers


def propose(
    result: Result,
    task: OptionalTask = None,
    policy: Annotated[
        str | None,
        typer.Option(
            "--policy",
            help="Let this policy choose, rather than what tells most.",
            autocompletion=words("random"),
        ),
    ] = None,
    candidates: Annotated[
        int, typer.Option("--candidates", min=1, help="Random actions that are compared.")
    ] = 48,
    amplitude: Annotated[
        list[str], typer.Option("--amplitude", help="INPUT=VALUE, above 0: how far an input may be driven.")
    ] = [],  # noqa: B006
    out: Annotated[Path | None, typer.Option("--out", help="File to write; default stdout.")] = None,
    csv: Annotated[
        Path | None, typer.Option("--csv", help="Also the inputs, in the columns and units of the log.")
    ] = None,
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    config: Config = None,
) -> None:
    """Propose what to run on the machine next, as JSON.

    Example: capture propose run.estimate --out proposal.json
    """
    from capture_cli.stages.propose import propose as stage
    from capture_cli.stores.output import new_file, refuse_existing
    from capture_cli.stores.provenance import write_json

    for file in (out, csv):
        if file is not None:
            refuse_existing(file, force=force)
    document = stage(
        result=result,
        task=task,
        policy=policy,
        candidates=candidates,
        amplitude=named_numbers(amplitude, "--amplitude"),
        seed=seed,
        threads=threads,
        out=out,
        csv=csv,
    )
    if csv is not None:
        from capture_cli.stages.proposal_csv import proposal_csv

        with new_file(csv, force=force) as file:
            file.write_text(proposal_csv(document, result, task), encoding="utf-8")
    if out is None:
        print_json(document)
    else:
        with new_file(out, force=force) as file:
            write_json(file, document)
    print(document["text"], file=sys.stderr)
