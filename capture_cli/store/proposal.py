"""proposal.json: the next action to run on a machine, as `capture propose` gives it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.common.documents import read_json
from capture_cli.errors import OptionError
from capture_cli.store.result import Keys, Rows

FORMAT = "capture/proposal"
VERSION = 1
HEADER = ("format", "version", "task", "kind")


@dataclass(frozen=True, kw_only=True)
class ProposalRecord(Keys):
    """proposal.json: an action by its components, or inputs by their names at the times `time_s`."""

    text: str
    action: Rows | None = None
    time_s: Sequence[float] | None = None
    inputs: Mapping[str, Sequence[float]] | None = None
    predicted: Rows | None = None


def read_action(path: Path, task: str, names: Sequence[str]) -> np.ndarray:
    """The action (action,) that the file `path` proposes for `task`, its components called `names`.

    Raises OptionError where it holds none.
    """
    values = _read(path, task, "action")["action"]
    missing = [name for name in names if name not in values]
    if missing:
        raise _no_proposal(path, "action", f"its action lacks {', '.join(missing)}")
    try:
        action = np.array([float(values[name]["value"]) for name in names])
    except (KeyError, TypeError, ValueError) as error:
        why = f"its action has no values: {type(error).__name__}: {error}"
        raise _no_proposal(path, "action", why) from error
    if not np.isfinite(action).all():
        raise _no_proposal(path, "action", "its action is not finite")
    return action


def read_inputs(path: Path, task: str, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """time (step,) s and inputs (step, input), called `names`, that the file `path` proposes for `task`.

    Raises OptionError where it holds none.
    """
    document = _read(path, task, "inputs")
    if set(document["inputs"]) != set(names):
        found = ", ".join(document["inputs"])
        raise _no_proposal(path, "inputs", f"they are of ({found}), and the task has ({', '.join(names)})")
    try:
        time = np.array(document["time_s"], dtype=float)
        inputs = np.array([document["inputs"][name] for name in names], dtype=float).T
    except (KeyError, TypeError, ValueError) as error:
        why = f"they have no values: {type(error).__name__}: {error}"
        raise _no_proposal(path, "inputs", why) from error
    if time.shape != (len(inputs),) or len(time) < 2:
        raise _no_proposal(path, "inputs", f"{len(inputs)} values of each and {time.size} times")
    if not (np.isfinite(time).all() and np.isfinite(inputs).all() and np.all(np.diff(time) > 0)):
        raise _no_proposal(path, "inputs", "they are not finite, or time_s does not increase")
    return time, inputs


def _read(path: Path, task: str, kind: str) -> dict[str, Any]:
    """The document of `kind` for `task` in the file `path`. Raises OptionError where it is another."""
    document = read_json(path, OptionError, cure=_cure(kind))
    if not isinstance(document, dict):
        raise _no_proposal(path, kind, f"it is no object, but {document!r:.60}")
    found, expected = tuple(map(document.get, HEADER)), (FORMAT, VERSION, task, kind)
    if found != expected:
        raise _no_proposal(path, kind, f"{', '.join(HEADER)} are {found!r:.200}; expected {expected}")
    if not isinstance(document.get(kind), dict):
        raise _no_proposal(path, kind, f"{kind!r} is missing")
    return document


def _no_proposal(path: Path, kind: str, why: str) -> OptionError:
    return OptionError(f"{path} holds no {kind}: {why}", cure=_cure(kind))


def _cure(kind: str) -> str:
    made = "make it with `capture propose ESTIMATE --out FILE`"
    if kind != "inputs":
        return made
    return f"{made}, or give a log: `capture import-log` makes one of CSV and Parquet files"
