"""Which code a figure depends on: a hash of the modules that a module imports, and of those that they import."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("capture_cli", "benchmarks")
PICTURES = "capture_cli.report"  # what is drawn of a figure does not change it


def code_hash(modules: Iterable[str], folders: Iterable[str] = ()) -> str:
    """16 hex digits over the source of `modules`, of all they import from this project, and of `folders`.

    modules: dotted names. folders, relative to the project: plug-ins that are imported by name, models.
    """
    files = {*imported_files(modules), *(f for name in folders for f in _sources(ROOT / name))}
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(file.relative_to(ROOT).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def imported_files(modules: Iterable[str]) -> set[Path]:
    """The files of `modules` and of everything in this project that they import, anywhere in their code."""
    found: dict[str, Path] = {}
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        file = _file(name)
        if file is None or name in found or name.startswith(PICTURES):
            continue
        found[name] = file
        waiting += _imports(file)
    return set(found.values())


def _file(module: str) -> Path | None:
    """None for what is not a module of this project."""
    if module.split(".")[0] not in PACKAGES:
        return None
    path = ROOT.joinpath(*module.split("."))
    candidates = (path.with_suffix(".py"), path / "__init__.py")
    return next((c for c in candidates if c.is_file()), None)


def _imports(file: Path) -> Sequence[str]:
    return _imported_names(file.read_text(encoding="utf-8"))


@cache  # of many modules of which one was changed the others are not read anew
def _imported_names(text: str) -> Sequence[str]:
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            found += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return found


def _sources(folder: Path) -> Iterator[Path]:
    yield from (f for f in folder.rglob("*.*") if f.suffix in (".py", ".xml", ".toml"))
