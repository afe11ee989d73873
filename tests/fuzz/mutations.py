"""Values that no sound file has, and how a sound file becomes another: byte by byte, or part by part."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from typing import Any

from hypothesis import strategies as st


class Raw(str):
    """Text that stands in a document as it is, whatever it means there."""


class Sound(bytes):
    """The content of a file, without all of it in messages of hypothesis."""

    def __repr__(self) -> str:
        return f"{len(self)} bytes"


class Document(dict):
    """A document, without all of it in messages of hypothesis."""

    def __repr__(self) -> str:
        return f"a document of {len(self)} parts"


LONG = ("9" * 400, "9" * 5000)
# As CSV, MJCF and the command line have them, where each is a text.
NUMBERS = (
    "0",
    "-1",
    "1",
    "2",
    "0.5",
    "-0.0",
    "1e-12",
    "1e-7",
    "1e-320",
    "1e15",
    "1e16",
    "1e300",
    "-1e308",
    "1e400",
    "nan",
    "NaN",
    "inf",
    "-Infinity",
    "2000000000",
    "1000000",
    "4294967296",
    "0x10",
    "1_000",
    "1,5",
    "5G",
    "",
    " ",
    "1 2 3",
    "true",
    "null",
    "１２",
    "--1",
    *LONG,
)
TEXTS = (
    "",
    " ",
    "[/]",
    "[bold red]x",
    "<img src=x onerror=alert(1)>",
    "a\x1b[31mb",
    "a\nb",
    "a\tb",
    "x" * 300,
    "x" * 5000,
    "y" * 40_000,
    "é",
    "\u202e",
    "\u2028",
    "{{7*7}}",
    "{0}",
    "%s",
    "'",
    '"',
    "\\",
    "a/b",
    "..",
    "../x",
    ".",
    "~",
    "-",
    "--help",
    "*",
    "a,b",
    "a:b",
    "a=b",
    "a@b",
    "ﬁ",
    "日本",
    "😀",
    "NaN",
    "null",
    "model.xml",
    "air-hockey",
)
DEEP = Raw("[" * 100_000)
# As TOML and JSON both write them.
WHOLE = tuple(
    map(
        Raw,
        (
            "0",
            "-1",
            "1",
            "2",
            "3",
            "1000",
            "1000000",
            "2147483648",
            "9223372036854775807",
            "9223372036854775808",
            "-9223372036854775809",
            *LONG,
        ),
    )
)
FRACTIONS = tuple(
    map(
        Raw,
        (
            "0.0",
            "-0.0",
            "0.5",
            "-1.5",
            "1e-12",
            "1e-320",
            "1e15",
            "1e16",
            "1e300",
            "-1e308",
            "1e308",
            "1e400",
        ),
    )
)
OTHERS = (
    Raw("true"),
    Raw("false"),
    Raw("[]"),
    Raw("{}"),
    Raw("[[]]"),
    Raw("[0, 1]"),
    Raw('["a", 1]'),
    DEEP,
    Raw("[" * 65 + "]" * 65),
    Raw('["' + '", "'.join("abc" * 400) + '"]'),
)
OF_JSON = tuple(
    map(
        Raw,
        (
            "null",
            "NaN",
            "Infinity",
            "-Infinity",
            r'"\ud800"',
            r'"a\u0000b"',
            r'"\u001b[2J"',
            '{"a": 1, "a": 2}',
            '{"a":' * 70 + "1" + "}" * 70,
        ),
    )
)
OF_TOML = tuple(
    map(Raw, ("nan", "inf", "-inf", "0xff", "1979-05-27", "07:32:00", r'"a\u0000b"', r'"\u001b[2J"'))
)

values = st.one_of(*(st.sampled_from(some) for some in (WHOLE, FRACTIONS, OTHERS, TEXTS)))
json_values = st.one_of(values, st.sampled_from(OF_JSON))
toml_values = st.one_of(values, st.sampled_from(OF_TOML))


@st.composite
def mutated_bytes(draw, data: bytes, most: int = 4) -> bytes:
    """`data` after one to `most` accidents."""
    found = bytearray(data)
    for _ in range(draw(st.sampled_from((1, 1, 1, most)))):
        at = draw(st.integers(0, max(len(found) - 1, 0)))
        length = draw(st.sampled_from((1, 2, 4, 8, 64, 1000)))
        match draw(st.sampled_from(("flip", "cut", "end", "repeat", "insert", "overwrite", "swap"))):
            case "flip" if found:
                found[at] ^= 1 << draw(st.integers(0, 7))
            case "cut":
                del found[at : at + length]
            case "end":
                del found[at:]
            case "repeat":
                found[at:at] = bytes(found[at : at + length]) * draw(st.sampled_from((1, 2, 100)))
            case "insert":
                found[at:at] = draw(_pieces)
            case "overwrite":
                piece = draw(_pieces)
                found[at : at + len(piece)] = piece
            case "swap":
                other = draw(st.integers(0, max(len(found) - 1, 0)))
                found[at : at + length], found[other : other + length] = (
                    found[other : other + length],
                    found[at : at + length],
                )
    return bytes(found)


_pieces = st.one_of(
    st.binary(min_size=1, max_size=16),
    st.sampled_from([t.encode() for t in (*NUMBERS, *TEXTS) if t]),
    st.sampled_from(
        (
            b"\0" * 8,
            b"\xff" * 8,
            b"\x7f" * 4,
            b"\xef\xbb\xbf",
            b"\r\n",
            b"\n" * 3,
            b"\xc3\x28",
            b"\xed\xa0\x80",
        )
    ),
)


def places(document: Any) -> Iterator[tuple]:
    """The path of every part of a document, its containers too."""
    items = (
        document.items()
        if isinstance(document, dict)
        else enumerate(document)
        if isinstance(document, list)
        else ()
    )
    for key, value in items:
        yield (key,)
        yield from ((key, *rest) for rest in places(value))


@st.composite
def mutated(draw, document: Any, values: st.SearchStrategy = json_values, most: int = 3) -> Any:
    """`document` with one to `most` of its parts replaced, left out, added, renamed, or put elsewhere."""
    found = copy.deepcopy(document)
    for _ in range(draw(st.sampled_from((1, 1, most)))):
        everywhere = list(places(found))
        if not everywhere:
            return found
        *way, key = draw(st.sampled_from(everywhere))
        inner = part_at(found, way)
        match draw(
            st.sampled_from(
                ("replace", "replace", "replace", "scale", "remove", "add", "rename", "copy", "repeat")
            )
        ):
            case "replace":
                inner[key] = copy.deepcopy(draw(values))
            case "scale" if isinstance(inner[key], int | float) and not isinstance(inner[key], bool):
                inner[key] *= draw(st.sampled_from((-1, 0, 1e-6, 1e3, 1e6, 1e300)))
            case "remove":
                del inner[key]
            case "add" if isinstance(inner, dict):
                inner[draw(st.sampled_from(TEXTS))] = copy.deepcopy(draw(values))
            case "rename" if isinstance(inner, dict):
                inner[draw(st.sampled_from(TEXTS))] = inner.pop(key)
            case "copy":
                inner[key] = copy.deepcopy(part_at(found, draw(st.sampled_from(everywhere))))
            case "repeat" if isinstance(inner, list):
                inner[key:key] = [
                    copy.deepcopy(inner[key]) for _ in range(draw(st.sampled_from((1, 3, 1000))))
                ]
    return found


def part_at(document: Any, way: tuple) -> Any:
    for key in way:
        document = document[key]
    return document


def json_text(value: Any) -> str:
    if isinstance(value, Raw):
        return str(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)}: {json_text(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(json_text, value)) + "]"
    return json.dumps(value)


def toml_text(table: dict[str, Any], way: tuple[str, ...] = ()) -> str:
    """A document of tables and values, as TOML writes it."""
    lines = [f"[{'.'.join(map(_key, way))}]"] if way else []
    lines += [f"{_key(k)} = {_toml_value(v)}" for k, v in table.items() if not isinstance(v, dict)]
    inner = [toml_text(v, (*way, k)) for k, v in table.items() if isinstance(v, dict)]
    return "\n".join([*lines, *inner])


def _toml_value(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(k)} = {_toml_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    return json_text(value)


def _key(name: str) -> str:
    return name if name.isascii() and name.replace("_", "").isalnum() else json.dumps(name)
