"""A single file that `capture inspect` is given: a proposal of `capture`, or what other command reads it."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from capture_cli.common.documents import read_json
from capture_cli.errors import OptionError, StoreError
from capture_cli.log.checks.base import finding
from capture_cli.log.readers import readers
from capture_cli.store.inspection import Inspection
from capture_cli.store.proposal import read_action, read_inputs

BRIEF = ("task", "kind", "text", "band_hz", "peaks", "action", "information", "expected_sd")

_OTHERS = {
    ".toml": "a task.toml is read by `capture tasks --task {path}`",
    ".xml": "a model is read with the task.toml that names it: `capture tasks --task task.toml`",
}
_READ_IN = "read it in first: `capture import-log {path} --task task.toml --out NAME.zarr`"


def read_header(path: Path) -> Mapping[str, Any]:
    """The top of a JSON file that `capture` wrote: format, version, and what else it has.

    Raises StoreError, naming what reads it where something does, for any other file.
    """
    with suppress(StoreError):
        document = read_json(path, StoreError, cure="")
        if isinstance(document, dict) and str(document.get("format")).startswith("capture/"):
            return document
    others = _OTHERS | dict.fromkeys(readers(), _READ_IN)
    otherwise = "give a log (.zarr), an estimate, a diagnosis or another output of `capture`"
    raise StoreError(
        f"{path} is a file, and neither a Zarr store nor JSON that `capture` wrote",
        cure=others.get(path.suffix.lower(), otherwise).format(path=path),
    )


def inspect_proposal(path: Path, seen: Inspection, proposed: Mapping[str, Any]) -> None:
    """Fill the inspection of the file at `path` in, whose JSON is `proposed`."""
    seen.task = task = proposed.get("task")
    seen.result = {key: proposed[key] for key in BRIEF if key in proposed}
    kind = "action" if proposed.get("kind") == "action" else "inputs"
    names = list(proposed[kind]) if isinstance(proposed.get(kind), dict) else []
    try:
        if kind == "action":
            read_action(path, task, names)
            seen.sizes = {"actions": len(names)}
        else:
            time, _ = read_inputs(path, task, names)
            seen.sizes = {"inputs": len(names), "steps": len(time)}
            seen.result |= {"duration_s": float(time[-1] - time[0])}
    except OptionError as error:
        seen.findings.append(finding("error", "proposal", error.message, error.cure))
