"""A case put into a folder, run, and judged."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from fuzz.cases import Case
from fuzz.forked_run import Ended, run
from fuzz.rule import faults, state


@dataclass(frozen=True)
class Outcome:
    """What came of a case, and what it did not do as it has to: (which of rule.KINDS, in words)."""

    case: Case
    ended: Ended
    faults: list[tuple[str, str]]


def attempt(case: Case, inputs: Path, place: Path) -> Outcome:
    """Run `case` in a new folder at `place`, which is gone then. inputs: see `sound_inputs`."""
    folder, temporary = place / "here", place / "temporary"
    temporary.mkdir(parents=True)
    lay_out(case, inputs, folder)
    before = state(place)
    try:
        ended = run(case.arguments, folder, temporary, enter=case.enter)
        inside = {p.removeprefix("here/"): s for p, s in before.items() if p.startswith("here/")}
        found = faults(case, ended, inside, folder)
        beside = sorted(p for p in state(place).keys() - before.keys() if not p.startswith("here/"))
        if beside:
            found.append(("left behind", f"beside its folder it left {beside[:5]}"))
    finally:
        remove(place)
    return Outcome(case, ended, found)


def lay_out(case: Case, inputs: Path, folder: Path) -> None:
    """Make the folder that a case is run in."""
    folder.mkdir(parents=True)
    for name in case.needs:
        copy = shutil.copytree if (inputs / name).is_dir() else shutil.copyfile
        copy(inputs / name, folder / name)
    for name, content in case.files.items():
        path = folder / name
        if content is None:
            path.unlink()
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    if case.prepare:
        case.prepare(folder)


def remove(place: Path) -> None:
    for root, names, _ in os.walk(place):
        for name in names:
            path = Path(root, name)
            if not path.is_symlink():
                path.chmod(0o700)
    shutil.rmtree(place, ignore_errors=True)
