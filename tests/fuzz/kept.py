"""Cases that are kept, to be run again: the command, and the files that it was given."""

from __future__ import annotations

import json
from pathlib import Path

from fuzz.cases import Case, Expected
from fuzz.kinds import KINDS
from fuzz.trial import Outcome

DOCUMENT, FILES = "case.json", "files"


def keep(outcome: Outcome, kind: str, folder: Path) -> None:
    """Write the case to `folder`, with what was wrong."""
    case, ended = outcome.case, outcome.ended
    document = {
        "kind": kind,
        "name": case.name,
        "arguments": case.arguments,
        "needs": case.needs,
        "outputs": case.outputs,
        "removed": [path for path, content in case.files.items() if content is None],
        "expected": None if case.expected is None else [case.expected.code, case.expected.words],
        "faults": outcome.faults,
        "code": ended.code,
        "stdout": ended.stdout[-2000:],
        "stderr": ended.stderr[-2000:],
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / DOCUMENT).write_text(json.dumps(document, indent=2))
    for path, content in case.files.items():
        if content is not None:
            (folder / FILES / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / FILES / path).write_bytes(content)


def read(folder: Path, inputs: Path) -> Case:
    """The case that was kept in `folder`; of a seed, what it is by now."""
    document = json.loads((folder / DOCUMENT).read_text())
    if document["name"]:
        return next(c for c in KINDS[document["kind"]].seeds(inputs) if c.name == document["name"])
    kept = folder / FILES
    files: dict[str, bytes | None] = {
        p.relative_to(kept).as_posix(): p.read_bytes() for p in sorted(kept.rglob("*")) if p.is_file()
    }
    expected = document["expected"]
    return Case(
        tuple(document["arguments"]),
        tuple(document["needs"]),
        files | dict.fromkeys(document["removed"]),
        tuple(document["outputs"]),
        None if expected is None else Expected(expected[0], tuple(expected[1])),
    )
