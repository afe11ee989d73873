"""proposal.json: the next action to run on a machine, as `capture propose` gives it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.errors import OptionError

FORMAT = "capture/proposal"
VERSION = 1


def read_action(path: Path, task: str, names: Sequence[str]) -> np.ndarray:
    """The action (action,) that the file `path` proposes for `task`, its components called `names`.

    Raises OptionError where it holds none.
    """
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
        found = tuple(document[key] for key in ("format", "version", "task", "kind"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, KeyError, TypeError) as error:
        raise _no_proposal(path, f"it cannot be read: {type(error).__name__}: {error}") from error
    expected = FORMAT, VERSION, task, "action"
    if found != expected:
        raise _no_proposal(path, f"format, version, task and kind are {found}; expected {expected}")
    values: dict[str, Any] = document.get("action", {})
    missing = [name for name in names if name not in values]
    if missing:
        raise _no_proposal(path, f"its action lacks {', '.join(missing)}")
    try:
        action = np.array([float(values[name]["value"]) for name in names])
    except (KeyError, TypeError, ValueError) as error:
        raise _no_proposal(path, f"its action has no values: {type(error).__name__}: {error}") from error
    if not np.isfinite(action).all():
        raise _no_proposal(path, "its action is not finite")
    return action


def _no_proposal(path: Path, why: str) -> OptionError:
    return OptionError(
        f"{path} holds no action: {why}", cure="make it with `capture propose ESTIMATE --out FILE`"
    )
