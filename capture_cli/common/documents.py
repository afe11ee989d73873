"""The one place that reads documents: TOML and JSON in files, and JSON that stands in other files.

Whoever wrote it, what comes out is made of finite numbers, whole numbers of 64 bits and texts that can be written, at
most `deepest` levels deep. What is not is refused: too large a file, one that may not be read, a folder, a device.
"""

import json
import math
import os
import re
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from capture_cli.common.frozen import frozen
from capture_cli.errors import CaptureError, beginning


@frozen
class SETTINGS:
    largest_toml: int = 2**18  # bytes: a table of a thousand channels, and its parser is slow
    largest_json: int = 2**24  # bytes: a minute of a proposal's inputs takes a tenth of it
    # lists and tables in a document: each takes a hundred bytes, and may be written in three
    most_parts: int = 1_000_000
    deepest: int = 64  # levels: those that `capture` writes have a dozen
    # In SI: nothing that is asked for, commanded, measured or identified is larger, and its square is far from
    # overflow.
    largest: float = 1e15
    largest_whole: int = 2**63  # below it, as TOML says and arrays hold
    most_digits: int = 19  # of such a number
    shown: int = 40  # characters, in a message, of a key or a value


CHECK_PATH = "check the path"
CORRECT = "correct the file at the place named"
# Keys with so many points: tomllib takes a time that grows with the square of them.
_LONG_KEY = re.compile(
    rf"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{SETTINGS.deepest}}}"""
)
_LONG_WHOLE = re.compile(r"(?<![\d_])[\d_]{4300,}")  # digits, as many as Python does not convert

# All but tab and line breaks: MuJoCo ends a name at the first zero, and a terminal obeys others.
_CONTROL = re.compile(r"[\0-\x08\x0b\x0c\x0e-\x1f\x7f]")

Place = tuple[Any, Any] | None  # (the place of what it is in, its own key there)


def read_toml(path: Path, raises: type[CaptureError], *, called: str | None = None) -> dict[str, Any]:
    """The table in the file at `path`, which messages name as `called`. Raises `raises` for what is none."""
    where = called or str(path)
    text = read_text(path, raises, most=SETTINGS.largest_toml, called=called)
    if found := _LONG_KEY.search(text):
        raise _too_deep(f"{where}, line {_line(text, found)}", raises, CORRECT)
    return _parsed("TOML", text, where, raises, CORRECT)


def read_json(path: Path, raises: type[CaptureError], *, cure: str) -> Any:
    """The document in the file at `path`. Raises `raises` where there is none, with `cure` for faults in it."""
    return parse_json(read_text(path, raises, most=SETTINGS.largest_json), str(path), raises, cure=cure)


def parse_json(
    text: str | bytes, where: str, raises: type[CaptureError], *, cure: str, any_numbers: bool = False
) -> Any:
    """The document in `text`, which stands `where`. Raises `raises`, with `cure`, for what is none.

    any_numbers: infinity, and whole numbers of more than 64 bits, as the state of a generator of random numbers.
    """
    decoded = _decoded(text, where, raises, cure)
    return _parsed("JSON", decoded, where, raises, cure, any_numbers=any_numbers)


def read_text(path: Path, raises: type[CaptureError], *, most: int, called: str | None = None) -> str:
    """The text in the file at `path`, of `most` bytes. Raises `raises` where there is none, or more of it."""
    where = called or str(path)
    with open_file(path, raises, called=called) as file:
        found = file.read(most + 1)
    if len(found) > most:
        raise raises(
            f"{where} has more than {most} bytes, the most that is read of such a file",
            cure="give the file that was meant, or a smaller one",
        )
    return _decoded(found, where, raises, "save it as text in UTF-8")


def open_file(
    path: Path, raises: type[CaptureError], *, called: str | None = None, elsewhere: str = CHECK_PATH
):
    """The file at `path`, open for reading bytes. Raises `raises` where there is no file, or it may not be read.

    elsewhere: the cure where there is none.
    """
    where = called or str(path)
    check_file(path, raises, called=called, elsewhere=elsewhere)
    try:
        return Path(path).open("rb")
    except OSError as error:
        raise unreadable(where, error, raises) from error


def check_file(
    path: Path, raises: type[CaptureError], *, called: str | None = None, elsewhere: str = CHECK_PATH
) -> int:
    """The size in bytes of the file at `path`. Raises `raises` where there is no file, with the cure `elsewhere`, or
    that cannot be told.
    """
    where = called or str(path)
    try:
        found = Path(path).stat()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise raises(f"{where} does not exist", cure=elsewhere) from error
    except (OSError, ValueError) as error:  # a ValueError for a path with a zero byte
        raise unreadable(where, error, raises) from error
    if stat.S_ISDIR(found.st_mode):
        raise raises(f"{where} is a folder, not a file", cure=elsewhere)
    if not stat.S_ISREG(found.st_mode):
        raise raises(
            f"{where} is a device or a pipe, not a file", cure="write its content to a file, and name that"
        )
    return found.st_size


def exists(path: Path, raises: type[CaptureError]) -> bool:
    """Whether there is anything at `path`. Raises `raises` where that cannot be told."""
    try:
        Path(path).stat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except (OSError, ValueError) as error:
        raise unreadable(str(path), error, raises) from error
    return True


def resolved(path: Path) -> Path:
    """The whole path, without links; one that leads to itself stays, where Path.resolve raises RuntimeError."""
    return Path(os.path.realpath(path))


def unreadable(where: str, error: Exception, raises: type[CaptureError]) -> CaptureError:
    """What to raise where the system does not let a file be read."""
    if isinstance(error, PermissionError):
        return raises(
            f"{where} may not be read: {error.strerror or error}",
            cure="check its permissions, and those of the folders above it",
        )
    return raises(f"{where} cannot be read: {getattr(error, 'strerror', None) or error}", cure=CHECK_PATH)


def _decoded(text: str | bytes, where: str, raises: type[CaptureError], cure: str) -> str:
    if isinstance(text, str):
        return text
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError as error:
        raise raises(f"{where} is not UTF-8 text: {error.reason} at byte {error.start}", cure=cure) from error


def _parser(form: str) -> Callable[[str], Any]:
    if form == "JSON":
        return json.loads
    import tomllib  # few commands read any

    return tomllib.loads


def _parsed(
    form: str, text: str, where: str, raises: type[CaptureError], cure: str, *, any_numbers: bool = False
) -> Any:
    if (parts := text.count("[") + text.count("{")) > SETTINGS.most_parts:
        raise raises(f"{where}: {parts} lists and tables, and {SETTINGS.most_parts} are the most", cure=cure)
    try:
        document = _parser(form)(text)
    except RecursionError as error:
        raise _too_deep(where, raises, cure) from error
    except ValueError as error:
        if found := _LONG_WHOLE.search(text):  # or else it is the number that Python says in a long sentence
            what = f"line {_line(text, found)} has a number of thousands of digits"
            raise raises(f"{where}: {what}, and {SETTINGS.most_digits} are the most", cure=cure) from error
        raise raises(f"{where} is not {form}: {error}", cure=cure) from error
    fault_of_leaf = _fault_of_text if any_numbers else _fault
    for place, fault in _faults(document, fault_of_leaf):
        if fault is None:
            raise _too_deep(where, raises, cure)
        raise raises(f"{where}: {_named(place)} {fault}", cure=cure)
    return document


def _too_deep(where: str, raises: type[CaptureError], cure: str) -> CaptureError:
    return raises(
        f"{where}: its tables or lists lie more than {SETTINGS.deepest} levels deep in each other", cure=cure
    )


def _faults(document: Any, fault_of_leaf: Callable[[Any], str | None]) -> Iterator[tuple[Place, str | None]]:
    """Faults that the parsers let pass: where, and in words; None for what is too deep. Without recursion."""
    containers: list[tuple[Any, Place, int]] = [((document,), None, 0)]
    while containers:
        container, place, depth = containers.pop()
        if depth > SETTINGS.deepest:
            yield place, None
            return
        if isinstance(container, dict):
            items = container.items()
            for key in container:
                if fault := _fault_of_text(key):
                    yield (place, key), fault
        else:
            items = enumerate(container)
        for key, value in items:
            if isinstance(value, dict | list):
                containers.append((value, (place, key), depth + 1))
            elif fault := fault_of_leaf(value):
                yield (place, key), fault


def _fault(value: Any) -> str | None:
    if isinstance(value, float):
        return None if math.isfinite(value) else f"= {value}; expected a finite number"
    if isinstance(value, int) and not -SETTINGS.largest_whole <= value < SETTINGS.largest_whole:
        digits = int(value.bit_length() * math.log10(2)) + 1
        return f"is a whole number of {digits} digits, and {SETTINGS.most_digits} are the most"
    return _fault_of_text(value)


def _fault_of_text(value: Any) -> str | None:
    """Why a text can be no name, path or output; None where it can, and for what is no text."""
    if not isinstance(value, str):
        return None
    if found := _CONTROL.search(value):
        return f"has the control character U+{ord(found[0]):04X}"
    if not value.isascii() and any("\ud800" <= character <= "\udfff" for character in value):
        return "has half of a surrogate pair, which is no character"
    return None


def _named(place: Place) -> str:
    """A place in words: `parameters.mass.low`, `rows[3]`."""
    keys = []
    while place is not None:
        place, key = place
        keys.append(key)
    words = "".join(f"[{key}]" if isinstance(key, int) else f".{_short(key)}" for key in keys[-2::-1])
    return words.removeprefix(".") or "it"


def _short(key: str) -> str:
    return beginning(key if key.isprintable() else repr(key)[1:-1], SETTINGS.shown)


def _line(text: str, found: re.Match) -> int:
    return text.count("\n", 0, found.start()) + 1
