"""One frozen version and one seed: what all rows of a folder have in common."""

from __future__ import annotations

import hashlib
import json
import secrets
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks._code_hash import code_hash
from capture_cli.errors import OptionError
from capture_cli.store.provenance import write_json

NAME = "frozen.json"


@dataclass(frozen=True)
class Frozen:
    """capture: hash of the version that is asked; logs: of the code that makes the logs. seed: of the cases.

    sealed: whether the seed was drawn when the code was frozen already, rather than chosen.
    """

    capture: str
    logs: str
    seed: int
    sealed: bool


def freeze(folder: Path, root: Path, seed: int | None) -> Frozen:
    """What `folder` was begun with, or, where it is new, the code as it is and a seed, drawn where None.

    Raises OptionError where code or seed are no longer those.
    """
    capture = capture_hash(root)
    logs = code_hash(["benchmarks._planted_logs.cases"], ["capture_cli/model/effects", "benchmarks/machines"])
    path = folder / NAME
    if not path.is_file():
        new = Frozen(capture, logs, secrets.randbits(31) if seed is None else seed, sealed=seed is None)
        folder.mkdir(parents=True, exist_ok=True)
        write_json(path, asdict(new))
        return new
    begun = Frozen(**json.loads(path.read_text(encoding="utf-8")))
    for what, was, now in (
        ("the version that is asked", begun.capture, capture),
        ("the code that makes the logs", begun.logs, logs),
        ("the seed", begun.seed, begun.seed if seed is None else seed),
    ):
        if was != now:
            raise OptionError(
                f"{folder}: {what} is {now}, and was {was} when the first log was drawn",
                cure="rows of different versions are not mixed: give another --out, for which a new seed is drawn",
            )
    return begun


def capture_hash(root: Path) -> str:
    """16 hex digits over the source of capture_cli in the checkout `root`."""
    folder = root / "capture_cli"
    files = sorted(folder.rglob("*.py"))
    if not files:
        raise OptionError(f"--root {root} holds no capture_cli", cure="name the folder of a checkout")
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.relative_to(folder).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]
