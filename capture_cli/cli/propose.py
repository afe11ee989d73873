"""`capture propose`: its help, and what it prints."""

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from capture_cli.cli._results import print_json
from capture_cli.options.propose import ProposeOptions


def propose(options: ProposeOptions) -> None:
    """Propose what to run on the machine next, as JSON, and print where that takes the identified model, open loop.

    Inputs stay such that the model stays near what the log shows: within the range of every output, widened by half of
    its span to either side, and within joints' ranges. Read what is printed before a machine is driven so.

    Example: capture propose run.estimate --out proposal.json
    """
    from capture_cli.common.json_text import json_text
    from capture_cli.stages.propose import proposal_csv
    from capture_cli.stages.propose import propose as stage
    from capture_cli.store.output import refuse_existing, refuse_misnamed, write_texts
    from capture_cli.store.proposal import ProposalRecord

    out, csv, force = options.out, options.csv, options.force
    for file, option, ending in ((out, "--out", ".json"), (csv, "--csv", ".csv")):
        if file is not None:
            refuse_misnamed(file, ending, option=option)
            refuse_existing(file, force=force)
    document = stage(options)
    texts = []
    if csv is not None:
        texts.append((csv, proposal_csv(document, options.result, options.task)))
    if out is not None:
        texts.append((out, json_text(document) + "\n"))
    if texts:
        write_texts(texts, force=force)
    if out is None:
        print_json(document)
    proposal = ProposalRecord.of(document)
    print(proposal.text, file=sys.stderr)
    for line in _predicted(proposal.predicted or {}):
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
