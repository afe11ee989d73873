"""An MJCF as it is written: numbers that are none, and counts that no machine has, by element, attribute and line."""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

from capture_cli.errors import ModelError

# attributes that say how many; those of a <size> that begin with nuser_ as well
_COUNTS = frozenset(
    [
        "ccd_iterations",
        "cellcount",
        "count",
        "height",
        "iterations",
        "ls_iterations",
        "nchannel",
        "ncol",
        "nconmax",
        "njmax",
        "nkey",
        "noslip_iterations",
        "nrow",
        "nsample",
        "nuserdata",
        "numquads",
        "numslices",
        "numstacks",
        "sdf_initpoints",
        "sdf_iterations",
        "width",
    ]
)
# attributes that hold words, which may read like a number
_WORDS = frozenset(["name", "class", "childclass", "file", "model", "prefix", "data", "key", "value"])
_NUMBER = re.compile(r"[+-]?(?:nan|inf|infinity|(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)", re.IGNORECASE)
_NO_NUMBER = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_PERHAPS_NO_NUMBER = re.compile("nan|inf", re.IGNORECASE)
_BYTES = re.compile(r"(\d+)([KMGTPE]?)")
_POWERS = {unit: 1 << 10 * power for power, unit in enumerate(["", *"KMGTPE"])}


@dataclass(frozen=True)
class Attribute:
    """One attribute as it is written. repeats: how often its element is made, by what it is in."""

    file: Path
    line: int
    element: str
    name: str
    value: str
    repeats: int = 1

    def __str__(self) -> str:
        value = self.value if len(self.value) <= 40 else f"{self.value[:40]}..."
        return f'{self.name}="{value}" of <{self.element}> ({self.file.name}, line {self.line})'

    @property
    def matters(self) -> bool:
        """Whether it counts something, names something, or may be no number."""
        named = self.name in ("name", "class", "memory") or self.element == "include"
        return named or bool(self.counts) or _PERHAPS_NO_NUMBER.search(self.value) is not None

    @property
    def counts(self) -> tuple[int, ...]:
        """The numbers of what it counts, () where it counts nothing."""
        if self.name not in _COUNTS and not self.name.startswith("nuser_"):
            return ()
        with_digits = [text for text in self.value.split() if text.isascii() and text.isdigit()]
        return tuple(int(text[:20]) for text in with_digits)  # of more digits Python makes no number at all

    @property
    def arena(self) -> int:
        """The bytes that it says a simulation may take, 0 where it says nothing of it."""
        found = _BYTES.fullmatch(self.value.strip()) if self.name == "memory" else None
        return int(found[1][:20]) * _POWERS[found[2]] if found else 0

    @property
    def size(self) -> int:
        """How much it makes of what it counts: of the larger of two a model is the larger."""
        return self.arena or (self.repeats * math.prod(self.counts) if self.counts else 0)


def refuse_bad_numbers(files: Sequence[Path]) -> None:
    """Raise ModelError where an attribute in one of the files is no finite number, or counts more than `most`."""
    attributes = list(_attributes(files))
    names = {a.value for a in attributes if a.name in ("name", "class")}
    # of anything that is counted: more takes MuJoCo minutes, or more memory than there is
    most = 100_000
    most_arena = 1 << 30  # bytes that each simulation may be given
    for attribute in attributes:
        if _is_no_number(attribute, names):
            raise ModelError(
                f"{attribute} is not a finite number",
                cure="give a number there, or leave the attribute out for MuJoCo's own",
            )
        made = attribute.repeats * max(attribute.counts, default=0) if attribute.counts else 0
        if made > most:
            often = f", made {attribute.repeats} times" if attribute.repeats > 1 else ""
            raise ModelError(
                f"{attribute}{often}: more than {most} of a thing are not simulated in any useful time",
                cure=f"give {attribute.name} the number that the machine has",
            )
        if attribute.arena > most_arena:
            raise ModelError(
                f"{attribute}: each simulation would take that much, and may take {most_arena >> 30} GB",
                cure=f"give less, or leave {attribute.name} out: MuJoCo takes what the model needs",
            )


def largest(files: Sequence[Path]) -> Attribute | None:
    """Of the attributes that say how much there is of something the one that makes most; None where none does."""
    return max((a for a in _attributes(files) if a.size > 1), key=lambda a: a.size, default=None)


def included(file: Path) -> list[Path]:
    """The files that the MJCF names for inclusion, from where it lies."""
    return [file.parent / a.value for a in _of(file) if (a.element, a.name) == ("include", "file")]


def _is_no_number(attribute: Attribute, names: set[str]) -> bool:
    """Whether one of its numbers is none. names: of elements, which other attributes may refer to."""
    if attribute.name in _WORDS or attribute.value in names:
        return False
    texts = attribute.value.split()
    return any(map(_NO_NUMBER.fullmatch, texts)) and all(map(_NUMBER.fullmatch, texts))


def _attributes(files: Sequence[Path]) -> Iterator[Attribute]:
    for file in files:
        yield from _of(file)


def _of(file: Path) -> list[Attribute]:
    """The attributes in the file that matter, as far as it is XML: where it is not MuJoCo says so itself."""
    found: list[Attribute] = []
    repeats = [1]  # of what is open
    parser = expat.ParserCreate()

    def begin(element: str, attributes: dict[str, str]) -> None:
        line = parser.CurrentLineNumber
        own = [Attribute(file, line, element, name, text, repeats[-1]) for name, text in attributes.items()]
        found.extend(a for a in own if a.matters)
        count = next((a.counts[0] for a in own if a.name == "count" and a.counts), 1)
        repeats.append(repeats[-1] * count if element == "replicate" else repeats[-1])

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda _: repeats.pop()
    try:
        with file.open("rb") as text:
            parser.ParseFile(text)
    except (expat.ExpatError, OSError, ValueError):
        pass
    return found
