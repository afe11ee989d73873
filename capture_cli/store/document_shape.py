"""Shapes of documents: a document is compared with its shape, and the first missing or mistyped part is named.

A shape is a Kind; {KEY: shape} for an object with these keys, and others ("KEY?": may be missing); {str: shape} for one
of any keys; [shape] for a list; or_none(shape). (A library for JSON schemas says what is wrong in the words of its
schema, not of the user's document.)
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from capture_cli.common.documents import SETTINGS as DOCUMENTS
from capture_cli.errors import StoreError, beginning


@dataclass(frozen=True)
class Kind:
    """What a value is, in words, and whether one is."""

    expected: str
    holds: Callable[[Any], bool]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


TEXT = Kind("a text", lambda v: isinstance(v, str))
NAME = Kind("a name", lambda v: isinstance(v, str) and bool(v.strip()))
FLAG = Kind("true or false", lambda v: isinstance(v, bool))
NUMBER = Kind("a number", _is_number)
POSITIVE = Kind("a number above 0", lambda v: _is_number(v) and v > 0)
WHOLE = Kind("a whole number of 0 or more", lambda v: _is_whole(v) and v >= 0)
COUNT = Kind("a whole number above 0", lambda v: _is_whole(v) and v > 0)
BOUNDS = Kind(
    "[low, high]", lambda v: isinstance(v, list) and len(v) == 2 and all(map(_is_number, v)) and v[0] < v[1]
)
NUMBERS = Kind(
    "a list of numbers, one or more", lambda v: isinstance(v, list) and bool(v) and all(map(_is_number, v))
)
OBJECT = Kind("an object", lambda v: isinstance(v, dict))
# as spaces, effects and features are written
PARAMETERS = [
    {"name": TEXT, "unit": TEXT, "low": NUMBER, "high": NUMBER, "nominal?": NUMBER, "step?": POSITIVE}
]
EFFECTS = [
    {
        "name": TEXT,
        "site": TEXT,
        "parameters": {
            str: {"value": NUMBER, "unit": TEXT, "low": NUMBER, "high": NUMBER, "drawn": [NUMBER]}
        },
    }
]
FEATURES = [{"name": TEXT, "unit": TEXT, "scale": POSITIVE}]


def or_none(shape: Any) -> tuple[Any, None]:
    """The shape, or null."""
    return shape, None


def check_shape(document: Any, shape: Any, where: object, cure: str) -> None:
    """Raise StoreError, which names the first part of `document`, read from `where`, that is not of `shape`."""
    for fault in _faults(document, shape, ""):
        raise StoreError(f"{where} cannot be read: {fault}", cure=cure)


def _faults(value: Any, shape: Any, name: str) -> Iterator[str]:
    if isinstance(shape, tuple):
        if value is not None:
            yield from _faults(value, shape[0], name)
    elif isinstance(shape, Kind):
        if not shape.holds(value):
            yield _unlike(value, shape.expected, name)
    elif isinstance(shape, list):
        if not isinstance(value, list):
            yield _unlike(value, "a list", name)
            return
        for number, item in enumerate(value):
            yield from _faults(item, shape[0], f"{name}[{number}]")
    elif not isinstance(value, dict):
        yield _unlike(value, OBJECT.expected, name)
    elif str in shape:
        for key, item in value.items():
            yield from _faults(item, shape[str], f"{name}.{key}".lstrip("."))
    else:
        yield from _faults_of_keys(value, shape, name)


def _faults_of_keys(value: dict[str, Any], shape: dict[str, Any], name: str) -> Iterator[str]:
    missing = [key for key in shape if not key.endswith("?") and key not in value]
    if missing:
        yield f"{', '.join(f'{name}.{key}'.lstrip('.') for key in missing)} missing"
    for key, inner in shape.items():
        key = key.removesuffix("?")
        if key in value:
            yield from _faults(value[key], inner, f"{name}.{key}".lstrip("."))


def _unlike(value: Any, expected: str, name: str) -> str:
    return f"{name or 'it'} is {beginning(repr(value), DOCUMENTS.shown)}; expected {expected}"
