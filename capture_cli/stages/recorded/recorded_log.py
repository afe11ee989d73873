"""The log that an estimate was made from, found again, and whether it is what it was."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from capture_cli.errors import OptionError
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.store.output import sha256


def recorded_log(result: Path, recorded: Mapping[str, Any]) -> MeasuredLog:
    """The log of the directory `result`, of which it recorded path and sha256.

    It is looked for from here, from the folder of `result`, and in that folder. Raises OptionError where none of these
    is the log as it was then, StoreError where it cannot be read.
    """
    path, beside = Path(recorded["path"]), Path(result).resolve().parent
    there = [p for p in (path, beside / path, beside / path.name) if p.is_dir()]
    for place in there:
        if sha256(place) == recorded["sha256"]:
            return MeasuredLog.read(place)
    found = f"{there[0]} has changed since" if there else "it is neither here nor beside it"
    raise OptionError(
        f"{result} does not say how far the inputs of its log {path} went, and {found}",
        cure="say how far each input may be driven: --amplitude INPUT=VALUE; or identify again",
    )
