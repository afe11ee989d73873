"""What a file is that a log comes in: columns of numbers, texts and times by the names in its header."""

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from capture_cli.errors import LogError, did_you_mean
from capture_cli.log.measured_log import LARGER
from capture_cli.log.readers._decimal_commas import GROUPS, NUMBER, has_decimal_commas
from capture_cli.log.readers._time_stamps import is_stamp, seconds
from capture_cli.store.zarr_store import SETTINGS as ZARR_STORE
from capture_cli.store.zarr_store import size

COMMENTS = ("#", "%", "//")
AS_A_NUMBER = (
    "write it as a number; a time in seconds, or in the unit that [log] time_scale gives, or in all rows as "
    "2026-11-23T10:00:00.005 or 10:00:00.005"
)
DECIMAL_COMMAS = (
    "write decimals with a point; or with a comma, and columns separated by semicolons, throughout the file"
)
QUOTE = 'remove that ", or close it at the end of its cell'
_DATE_OR_TIME = re.compile(r"\d+([-/.])\d+\1\d+|\d+:\d\d")  # how it begins


class SourceFile(ABC):
    """An open file: `columns` are the names in its header; values are read when asked for.

    suffixes: that names of such files end in. magic: the first bytes of all of them, if there are such.
    comments: how many lines before the header were passed over. most: bytes that is read of it. cure_of_one_column: of
    a file in which a single column was found, where the format has one of its own.
    Every reading method raises LogError where the file is not what its name says.
    """

    suffixes: tuple[str, ...]
    magic: bytes | None = None
    comments = 0
    cure_of_one_column: str | None = None

    def __init__(self, path: Path, most: int = ZARR_STORE.most):
        self.path = path
        self.most = most
        self.columns = self._read_columns()

    @abstractmethod
    def _read_columns(self) -> tuple[str, ...]:
        """The names of all columns."""

    @abstractmethod
    def numbers(self, names: Sequence[str]) -> np.ndarray:
        """The columns `names` as (row, column), NaN where a cell is empty."""

    @abstractmethod
    def labels(self, name: str) -> list[str | None]:
        """One column as text, (row,), None where a cell is empty."""

    @abstractmethod
    def place(self, row: int) -> str:
        """Where row `row` (from 0) stands in the file, for a message."""

    def times(self, name: str) -> np.ndarray | None:
        """The column `name` as s since its first time, (row,), NaN where a cell is empty; None where it has no texts
        that are times.
        """
        texts = self.labels(name)
        first = next((text for text in texts if text is not None), None)
        if first is None or not is_stamp(first):
            return None
        since, other = seconds(texts)
        if other is not None:
            raise LogError(
                f"{self.path}: column {name!r} holds {texts[other]!r:.60} at {self.place(other)}, and begins with "
                f"{first!r}",
                cure="write all its times alike: a date in all or in none, and a zone in all or in none",
            )
        return since

    def cut_off(self) -> str | None:
        """The last value of the last column where the file seems to end in mid-number; None where it does not."""
        return None

    def require(self, names: Sequence[str]) -> None:
        """Raise LogError unless each of `names` is the name of exactly one column."""
        for name in names:
            if name not in self.columns:
                there_are = did_you_mean(name, self.columns)
                if all(NUMBER.fullmatch(c) for c in self.columns):
                    there_are += " (these are numbers: the first line must name the columns)"
                cure = "correct the column in the task.toml, or in the first line of the file"
                if any(c.startswith(COMMENTS) for c in self.columns[:1]):
                    cure = "remove the mark at the start of that line if it names the columns, or add a line that does"
                elif len(self.columns) == 1:
                    cure = self.cure_of_one_column or cure
                raise LogError(f"{self.path} has no column {name!r}: {there_are}", cure=cure)
            if self.columns.count(name) > 1:
                raise LogError(
                    f"{self.path} has {self.columns.count(name)} columns named {name!r}",
                    cure="give each column a name of its own",
                )

    def _not_a_number(self, name: str, row: int, value: object) -> LogError:
        cure = "correct that cell; an empty one counts as missing, and --drop-nan drops its row"
        if row == 0:
            cure = "remove the row if it holds units; otherwise correct that cell"
        if '"' in str(value) or "\n" in str(value):
            cure = QUOTE
        elif str(value).startswith(COMMENTS):
            cure = "remove the line if it is a comment: only those before the header are passed over"
        elif _DATE_OR_TIME.match(str(value)):
            cure = AS_A_NUMBER
        elif GROUPS.fullmatch(str(value)):
            cure = "write it without commas: other numbers of the file have a decimal point, so these part thousands"
        elif NUMBER.fullmatch(str(value).replace(",", ".", 1)):
            cure = DECIMAL_COMMAS
        return LogError(
            f"{self.path}: column {name!r} holds {str(value)!r:.60} at {self.place(row)}, not a number",
            cure=cure,
        )

    def _numbers_of(self, columns: Mapping[str, Sequence[str | None]]) -> dict[str, np.ndarray]:
        """Columns of texts by name as numbers, (row,) each; a comma is a decimal point where the file shows that."""
        texts = {
            name: [t.strip() if t is not None else "nan" for t in cells] for name, cells in columns.items()
        }
        decimal = has_decimal_commas(texts.values())
        if decimal is None:
            raise self._ambiguous(texts)
        return {name: self._as_numbers(name, cells, decimal_comma=decimal) for name, cells in texts.items()}

    def _as_numbers(self, name: str, texts: Sequence[str], *, decimal_comma: bool) -> np.ndarray:
        values = np.empty(len(texts))
        for row, text in enumerate(texts):
            number = text.replace(",", ".") if decimal_comma else text
            if not NUMBER.fullmatch(number):
                raise self._not_a_number(name, row, text)
            values[row] = float(number)
        return values

    def _ambiguous(self, columns: Mapping[str, Sequence[str]]) -> LogError:
        name, row, text = next(
            (name, row, text)
            for name, texts in columns.items()
            for row, text in enumerate(texts)
            if "," in text
        )
        return LogError(
            f"{self.path}: column {name!r} holds {text!r:.60} at {self.place(row)}: nothing in the file tells whether "
            "that comma is a decimal point or parts thousands",
            cure="write the numbers of the file with decimal points and without commas",
        )


def too_large(path: Path, taken: int, most: int) -> LogError:
    """The error of a file that takes `taken` bytes where `most` are read."""
    return LogError(
        f"{path} takes {size(taken)} in memory, and the most that is read is {size(most)}", cure=LARGER
    )


def texts_of(column) -> list[str | None]:
    """A column of Arrow as texts, None where it is empty; those that are the same are kept once."""
    import pyarrow as pa

    chunks = column.chunks if isinstance(column, pa.ChunkedArray) else [column]
    texts: list[str | None] = []
    for chunk in chunks:
        coded = chunk if pa.types.is_dictionary(chunk.type) else chunk.dictionary_encode()
        words = [None if v is None else str(v) for v in coded.dictionary.to_pylist()]
        texts += [None if k is None else words[k] for k in coded.indices.to_pylist()]
    return texts
