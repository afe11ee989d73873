"""`provenance.json`: what made an output, from what, and how long it took."""

import importlib.metadata
import platform
import time
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import capture_cli
from capture_cli import __version__
from capture_cli.common.json_text import json_text
from capture_cli.store.output import PROVENANCE, sha256

FORMAT, VERSION = "capture/provenance", 1
# what the numbers depend on: names, and the distributions that say the version
PACKAGES = {"mujoco": "mujoco-core", **{name: name for name in ("numpy", "scipy", "torch", "zarr")}}


class Provenance:
    """Started when a stage starts; written when its output is complete."""

    def __init__(self, command: str, options: Mapping[str, Any], inputs: Mapping[str, Path | None]):
        self.command = command
        self.options = {name: _plain(value) for name, value in options.items()}
        self.inputs = {
            name: {"path": str(path), "sha256": sha256(path)}
            for name, path in inputs.items()
            if path is not None
        }
        self.began = datetime.now(UTC)
        self._clock = time.perf_counter()

    def document(self) -> dict[str, Any]:
        """The content of provenance.json, with the time taken so far."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "command": self.command,
            "options": self.options,
            "inputs": self.inputs,
            "capture": __version__,
            "code": code_hash(),
            "python": platform.python_version(),
            "packages": _versions(),
            "platform": platform.platform(),
            "began": self.began.isoformat(timespec="seconds"),
            "seconds": round(time.perf_counter() - self._clock, 3),
        }

    def write(self, folder: Path) -> None:
        """Write provenance.json into `folder`."""
        write_json(folder / PROVENANCE, self.document())


def _plain(value: Any) -> Any:
    """An option's value, JSON-able."""
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return str(value) if isinstance(value, Path) else value


@cache
def _versions() -> dict[str, str]:
    """Of PACKAGES, those that are installed; each is looked up in a long file."""
    found = {}
    for name, distribution in PACKAGES.items():
        with suppress(importlib.metadata.PackageNotFoundError):  # the core has no torch
            found[name] = importlib.metadata.version(distribution)
    return found


@cache
def code_hash() -> str:
    """Of the program's own sources: two checkouts of one version may differ."""
    package = Path(capture_cli.__file__).parent
    return sha256(package, {file.relative_to(package).as_posix() for file in package.rglob("*.py")})


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write `document`, refusing NaN and infinity, which JSON does not have."""
    path.write_text(json_text(document) + "\n", encoding="utf-8")
