"""What `capture propose` proposes in a file, and whether a machine or `record` can take it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from capture_cli.errors import OptionError
from capture_cli.log.checks.base import finding
from capture_cli.store.proposal import read_action, read_inputs

BRIEF = ("task", "kind", "text", "band_hz", "peaks", "action", "information", "expected_sd")


def inspect_proposal(path: Path, document: dict[str, Any], proposed: Mapping[str, Any]) -> None:
    """Fill the inspection `document` of the file at `path` in, whose JSON is `proposed`."""
    document["task"] = task = proposed.get("task")
    document["result"] = {key: proposed[key] for key in BRIEF if key in proposed}
    kind = "action" if proposed.get("kind") == "action" else "inputs"
    names = list(proposed[kind]) if isinstance(proposed.get(kind), dict) else []
    try:
        if kind == "action":
            read_action(path, task, names)
            document["sizes"] = {"actions": len(names)}
        else:
            time, _ = read_inputs(path, task, names)
            document["sizes"] = {"inputs": len(names), "steps": len(time)}
            document["result"] |= {"duration_s": float(time[-1] - time[0])}
    except OptionError as error:
        document["findings"].append(finding("error", "proposal", error.message, error.cure))
