"""`capture propose`: its options, and what it prints."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from capture_cli.cli._completion import words
from capture_cli.cli._config import Config
from capture_cli.cli._options import Force, OptionalTask, Result, Seed, Threads
from capture_cli.cli._results import print_json
from capture_cli.cli._texts import named_numbers


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
    beyond_log: Annotated[
        bool,
        typer.Option("--beyond-log", help="Also multisines that take the model beyond what the log shows."),
    ] = False,
    out: Annotated[Path | None, typer.Option("--out", help="File to write; default stdout.")] = None,
    csv: Annotated[
        Path | None, typer.Option("--csv", help="Also the inputs, in the columns and units of the log.")
    ] = None,
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    config: Config = None,
) -> None:
    """Propose what to run on the machine next, as JSON, and print where that takes the identified model, open loop.

    Inputs stay such that the model stays near what the log shows: within the range of every output, widened by half of
    its span to either side, and within joints' ranges. Read what is printed before a machine is driven so.

    Example: capture propose run.estimate --out proposal.json
    """
    from capture_cli.common.json_text import json_text
    from capture_cli.stages.propose import propose as stage
    from capture_cli.store.output import New, new_outputs, refuse_existing, refuse_misnamed

    for file, option, ending in ((out, "--out", ".json"), (csv, "--csv", ".csv")):
        if file is not None:
            refuse_misnamed(file, ending, option=option)
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
        beyond_log=beyond_log,
    )
    texts = []
    if csv is not None:
        from capture_cli.stages.excitation.proposal_csv import proposal_csv

        texts.append((csv, proposal_csv(document, result, task)))
    if out is not None:
        texts.append((out, json_text(document) + "\n"))
    if texts:
        with new_outputs(*(New(path) for path, _ in texts), force=force) as files:
            for file, (_, text) in zip(files, texts, strict=True):
                file.write_text(text, encoding="utf-8")
    if out is None:
        print_json(document)
    print(document["text"], file=sys.stderr)
    for line in _predicted(document.get("predicted") or {}):
        print(line, file=sys.stderr)


def _predicted(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Where the model is taken beside what the log shows, a line each; of joints' ranges, those alone that are left."""
    said = {name: row for name, row in rows.items() if row["log"] or not row["is_near"]}
    width = max(map(len, said), default=0)
    lines = ["predicted of the identified model, open loop, and in the log:"] if said else []
    for name, row in said.items():
        log = _range(row["log"]) if row["log"] else "not measured"
        beyond = "" if row["is_near"] else "  beyond"
        lines.append(f"  {name:<{width}}  {_range(row['range'])} {row['unit']}  (log {log}){beyond}")
    return lines


def _range(ends: Sequence[float]) -> str:
    return f"{ends[0]:.3g} to {ends[1]:.3g}"
