"""What an output holds, but for when it was made and how long that took."""

from __future__ import annotations

import json
import re
from datetime import datetime
from pathlib import Path
from typing import Any

from capture_cli.store.output import PROVENANCE

TIMES = {"began", "seconds"}  # keys of documents


def contents(path: Path) -> dict[str, bytes] | None:
    """The files of an output by their names, without times; None where there is nothing at `path`."""
    if path.is_file():
        return {path.name: _without_times(path)}
    if not path.is_dir():
        return None
    files = sorted(f for f in path.rglob("*") if f.is_file())
    return {f.relative_to(path).as_posix(): _without_times(f) for f in files}


def differences(found: dict[str, bytes] | None, expected: dict[str, bytes] | None) -> list[str]:
    """Names of files that are in one of two outputs alone, or have another content."""
    found, expected = found or {}, expected or {}
    return sorted(name for name in found.keys() | expected.keys() if found.get(name) != expected.get(name))


def _without_times(path: Path) -> bytes:
    content = path.read_bytes()
    try:
        if path.suffix in (".json", ".jsonl"):
            return b"\n".join(
                json.dumps(_stripped(json.loads(d))).encode() for d in _documents(path, content)
            )
        if path.name == "report.html":
            return _page_without_times(path, content)
    except (OSError, ValueError):
        pass  # it is not whole: then it is another
    return content


def _documents(path: Path, content: bytes) -> list[bytes]:
    return content.splitlines() if path.suffix == ".jsonl" else [content]


def _stripped(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _stripped(v) for k, v in value.items() if k not in TIMES}
    return [_stripped(v) for v in value] if isinstance(value, list) else value


def _page_without_times(path: Path, content: bytes) -> bytes:
    """The page of a result without what it took from the provenance beside it."""
    made = json.loads((path.parent / PROVENANCE).read_text(encoding="utf-8"))
    began = datetime.fromisoformat(made["began"])
    for text in (made["began"], f"{began.day} {began:%B %Y, %H:%M} UTC"):
        content = content.replace(text.encode(), b"")
    return re.sub(rb"(took|in) [0-9.e-]+ s\b", b"", content)
