"""One input: the files it is made of, the command that gets it, and how that has to end, where it is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class Expected:
    """The exit code, and words that stdout or stderr has, whatever its line breaks are."""

    code: int
    words: tuple[str, ...] = ()


def refused(*words: str) -> Expected:
    return Expected(2, words)


def taken(*words: str) -> Expected:
    return Expected(0, words)


@dataclass(frozen=True)
class Case:
    """arguments: of `capture`, in a folder that has copies of the sound inputs `needs`, with `files`, content by path,
    written over them; None for one that is removed.

    outputs: what it may leave there, where it ends with 0; one of them it has to leave. name: of a seed. prepare:
    what else is done with the folder. enter: what the process does in it before `capture` begins.
    """

    arguments: tuple[str, ...]
    needs: tuple[str, ...] = ()
    files: Mapping[str, bytes | None] = field(default_factory=dict)
    outputs: tuple[str, ...] = ()
    expected: Expected | None = None
    name: str = ""
    prepare: Callable[[Path], None] | None = None
    enter: Callable[[], None] | None = None
