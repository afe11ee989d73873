"""Errors a user can mend.

Every message says what was found, what was expected and where; `cure` says what to do about it. The command
line prints both and exits with 2. Anything that is not one of these is our fault and exits with 1; but Interrupted is
nobody's, and exits as a signal does.
"""

import difflib
from collections.abc import Iterable


class CaptureError(Exception):
    """What was found, what was expected and where (`message`), and what mends it (`cure`)."""

    def __init__(self, message: str, *, cure: str):
        super().__init__(message)
        self.message = message
        self.cure = cure.replace("\n", " ")  # it is the last line

    def __reduce__(self):
        # what a worker on another host raises is sent here
        return _raised, (type(self), self.message, self.cure)

    def __str__(self) -> str:
        return f"{self.message}\n  cure: {self.cure}"


def _raised(kind: type[CaptureError], message: str, cure: str) -> CaptureError:
    return kind(message, cure=cure)


class OptionError(CaptureError):
    """A command-line option, or a key of a --config file, that cannot be used."""


class TaskError(CaptureError):
    """A task.toml that does not say what it must, or says something that cannot be."""


class ModelError(CaptureError):
    """An MJCF that does not compile, or that lacks what a task refers to."""


class LogError(CaptureError):
    """Measured data that cannot be used: not finite, not in order, too short, of another task."""


class StoreError(CaptureError):
    """A Zarr store or a result directory that is foreign, truncated, or of another version."""


class OutputError(CaptureError):
    """An output that cannot be written: it exists, or the disk is full."""


class FitError(CaptureError):
    """A fit that cannot start or go on: a parameter moves nothing, every trial diverges, a training does."""


class OutOfTime(Exception):
    """The time that a search was given is over."""


class Interrupted(KeyboardInterrupt):
    """A run that a signal ended: what is kept of it (`message`), and how to go on (`cure`)."""

    def __init__(self, message: str, *, cure: str):
        super().__init__(f"{message}\n  cure: {cure}")


LONGEST = 990  # characters of a message on stderr, where a line break ends it
LONGEST_CURE = 500  # of these
LEFT_OUT = " [...] "


def shortened(message: str) -> str:
    """A message as it is shown: of LONGEST characters, its last line, the cure, before all; without what moves a
    terminal's cursor or changes its colours, as a name from a file may.
    """
    found, newline, cure = "".join(map(_visible, message)).rpartition("\n")
    if newline:
        cure = beginning(cure, LONGEST_CURE)
    return f"{cut(found, LONGEST - len(cure) - len(newline))}{newline}{cure}"


def cut(text: str, most: int) -> str:
    """`text` of `most` characters: both of its ends say something, what it is of, and what is wrong."""
    if len(text) <= most:
        return text
    room = (most - len(LEFT_OUT)) // 2
    return f"{text[:room]}{LEFT_OUT}{text[-room:]}"


def beginning(text: str, most: int) -> str:
    """`text` of `most` characters: what it begins with."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def first_of(items: Iterable[object], most: int, count: int | None = None) -> str:
    """The first `most` items, and how many more there are, of `count` in all: of as many as are given where None."""
    names = [str(item) for item in items]
    rest = (len(names) if count is None else count) - len(names[:most])
    return ", ".join(names[:most]) + (f" and {rest} more" if rest else "")


def _visible(character: str) -> str:
    return character if character.isprintable() or character == "\n" else repr(character)[1:-1]


MANY = 20  # names: where one is near, more are not listed beside it


def did_you_mean(name: str, candidates: Iterable[str]) -> str:
    """The end of a message that lists what exists, nearest names first."""
    candidates = sorted(set(candidates))
    if not candidates:
        return "there are none"
    same = [c for c in candidates if c.casefold() == name.casefold()]
    close = same or difflib.get_close_matches(name, candidates, n=3, cutoff=0.5)
    if close:
        near = f"did you mean {', '.join(map(repr, close))}?"
        return near if len(candidates) > MANY else f"{near} There are: {', '.join(candidates)}"
    return f"there are: {', '.join(candidates)}"
