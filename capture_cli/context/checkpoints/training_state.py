"""Files of a training under way: its metrics, and the state from which an interrupted one is resumed.

A state is counters, arrays and what was being trained, in one safetensors file; metrics are a line of JSON each.
"""

import json
from collections.abc import Iterable, Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.common.documents import parse_json
from capture_cli.errors import OptionError, StoreError, beginning
from capture_cli.store.document_shape import OBJECT, check_shape
from capture_cli.store.output import renewed
from capture_cli.store.tensors import read_arrays, save_arrays

STATE = "state.safetensors"  # not of a training that is complete
METRICS = "metrics.jsonl"


def write_metrics(folder: Path, metrics: Iterable[Mapping[str, Any]]) -> None:
    """Put the metrics of every evaluation so far into `folder`."""
    lines = (json.dumps(m, allow_nan=False) + "\n" for m in metrics)
    (folder / METRICS).write_text("".join(lines), encoding="utf-8")


def save_state(
    folder: Path, counters: Mapping[str, Any], arrays: Mapping[str, np.ndarray], recipe: Mapping[str, Any]
) -> None:
    """Put the state into `folder` in place of the last one. recipe: what runs that do the same have in common."""
    with renewed(folder / STATE) as file:
        save_arrays(file, arrays, {"counters": json.dumps(counters), "recipe": json.dumps(recipe)})


def load_state(
    folder: Path, recipe: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
    """Counters and arrays from `folder`; None where there is no state.

    Raises StoreError for a damaged one, OptionError for one of a run with another recipe.
    """
    state = read_state(folder)
    if state is None:
        return None
    earlier, counters, arrays = state
    check_recipe(earlier, recipe)
    return counters, arrays


def read_state(folder: Path) -> tuple[dict[str, Any], dict[str, Any], dict[str, np.ndarray]] | None:
    """Recipe, counters and arrays from `folder`, whatever training it is of; None where there is no state.

    Raises StoreError for a damaged one.
    """
    path, cure = folder / STATE, "begin anew with --force"
    if not path.is_file():
        return None
    arrays, metadata = read_arrays(path, cure)
    recipe, counters = (_parsed(metadata, part, path, cure) for part in ("recipe", "counters"))
    return recipe, counters, arrays


def _parsed(metadata: Mapping[str, str], part: str, path: Path, cure: str) -> dict[str, Any]:
    """One of the objects in the metadata of the state at `path`. Raises StoreError where there is none."""
    where = f"{path}: {part}"
    found = parse_json(metadata.get(part, "null"), where, StoreError, cure=cure, any_numbers=True)
    check_shape(found, OBJECT, where, cure)
    return found


def kept(folder: Path) -> str:
    """What an interrupted training can go on from, in words; "" before the first evaluation."""
    return "what was learned up to the last evaluation is kept" if (folder / STATE).is_file() else ""


def check_recipe(earlier: Mapping[str, Any], recipe: Mapping[str, Any], run: str = "the earlier run") -> None:
    """Raise OptionError where the recipe of an `earlier` run, which is resumed or complete, is another.

    run: what the message calls it.
    """
    wanted = json.loads(json.dumps(recipe))
    if earlier != wanted:
        raise OptionError(
            f"--resume: {run} differs: {'; '.join(_differences(earlier, wanted))}",
            cure="give the options that it began with, or begin anew with --force",
        )


def check_made(found: Mapping[str, Any], recipe: Mapping[str, Any], run: str = "the earlier run") -> None:
    """The same of what a run has written of itself, `found`, which may say more than the recipe."""
    check_recipe({name: found.get(name) for name in recipe}, recipe, run)


def _differences(before: Any, now: Any, path: str = "") -> list[str]:
    if isinstance(before, dict) and isinstance(now, dict):
        keys = sorted(before.keys() | now.keys())
        return [
            line for k in keys for line in _differences(before.get(k), now.get(k), f"{path}.{k}".lstrip("."))
        ]
    if isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        pairs = zip(before, now, strict=True)
        return [line for k, pair in enumerate(pairs) for line in _differences(*pair, f"{path}[{k}]")]
    if before == now:
        return []
    was, is_now = _where_they_differ(str(before), str(now))
    return [f"{path} was {was}, now {is_now}"]


def _where_they_differ(one: str, other: str) -> list[str]:
    """The beginnings of two texts, from a little before the first difference on."""
    shown, before = 60, 15  # characters
    pairs = enumerate(zip_longest(one, other))
    same = next((k for k, (a, b) in pairs if a != b), 0)
    skipped = max(same - before, 0) if max(len(one), len(other)) > shown else 0
    return [beginning("..." * bool(skipped) + text[skipped:], shown) for text in (one, other)]
