"""Files that logs come in, as columns of numbers: CSV (comma, semicolon or tab) and Parquet."""

from __future__ import annotations

import csv
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from capture_cli.common.documents import check_file, open_file
from capture_cli.errors import LogError, did_you_mean
from capture_cli.log.measured_log import LARGER
from capture_cli.log.readers.decimal_commas import GROUPS, NUMBER, WHOLE, has_decimal_commas
from capture_cli.log.readers.time_stamps import is_stamp, seconds
from capture_cli.store.memory_limit import memory_limit
from capture_cli.store.zarr_store import MOST, MOST_OF_FEW, MOST_TIMES, WORKING_MEMORY, size

PARQUET_SUFFIXES = (".parquet", ".pq")
SUFFIXES = (".csv", ".tsv", ".txt", *PARQUET_SUFFIXES)
PARQUET = b"PAR1"
OTHER_KINDS = {  # by the first bytes: what it is, and the cure
    PARQUET: ("a Parquet file", "rename it to end in .parquet"),
    b"PK\x03\x04": ("a zip archive or an Excel workbook", "unpack it; of a workbook, save its sheet as CSV"),
    b"\x1f\x8b": ("compressed by gzip", "unpack it (gunzip), and name what it holds .csv or .parquet"),
    b"(\xb5\x2f\xfd": ("compressed by zstd", "unpack it (unzstd), and name what it holds .csv or .parquet"),
    b"\x89HDF": ("an HDF5 file", "convert its columns to CSV or Parquet"),
    b"\x89MCAP": ("an MCAP recording", "convert its topics to CSV or Parquet"),
    b"#ROSBAG": ("a ROS bag", "convert its topics to CSV or Parquet"),
}
COMMENTS = ("#", "%", "//")
DELIMITERS = ",;\t"
LONGEST_LINE = 2**20  # characters: a thousand columns take a hundredth
TAIL = 2**16  # bytes at the end of a file, in which its last line is compared with those before
FEWEST_ABOVE = 10  # lines that the last one is compared with
FIRST_ROWS = 1000  # lines of a file that are looked at to see whether all are alike
AS_A_NUMBER = (
    "write it as a number; a time in seconds, or in the unit that [log] time_scale gives, or in all rows as "
    "2026-11-23T10:00:00.005 or 10:00:00.005"
)
DECIMAL_COMMAS = (
    "write decimals with a point; or with a comma, and columns separated by semicolons, throughout the file"
)
QUOTE = 'remove that ", or close it at the end of its cell'
csv.field_size_limit(LONGEST_LINE)
_DATE_OR_TIME = re.compile(r"\d+([-/.])\d+\1\d+|\d+:\d\d")  # how it begins
_SEPARATOR = re.compile(r'"?sep=.?"?\s*', re.IGNORECASE)  # a first line for Excel, not of the data


class SourceFile(ABC):
    """An open file: `columns` are the names in its header; values are read when asked for.

    comments: how many lines before the header were passed over. most: bytes that is read of it.
    Every reading method raises LogError where the file is not what its name says.
    """

    comments = 0

    def __init__(self, path: Path, most: int = MOST):
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
                there_are = did_you_mean(name, self.columns) + self._no_header()
                cure = "correct the column in the task.toml, or in the first line of the file"
                if any(c.startswith(COMMENTS) for c in self.columns[:1]):
                    cure = "remove the mark at the start of that line if it names the columns, or add a line that does"
                elif len(self.columns) == 1:
                    cure = self._cure_of_one_column(cure)
                raise LogError(f"{self.path} has no column {name!r}: {there_are}", cure=cure)
            if self.columns.count(name) > 1:
                raise LogError(
                    f"{self.path} has {self.columns.count(name)} columns named {name!r}",
                    cure="give each column a name of its own",
                )

    def _cure_of_one_column(self, cure: str) -> str:
        """What to do about a file in which a single column was found, where `cure` is what would otherwise be done."""
        return cure

    def _no_header(self) -> str:
        if all(NUMBER.fullmatch(c) for c in self.columns):
            return " (these are numbers: the first line must name the columns)"
        return ""

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
        """Columns of texts by name as numbers, (row,) each; a comma is the decimal point where the file says so."""
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


def open_source(path: Path, most: int | None = None) -> SourceFile:
    """The file at `path`, which may take `most` bytes; where None MOST, or less of one that has few bytes.

    Raises LogError where it is missing, empty, too large, or of a kind that is not read.
    """
    path = Path(path)
    if path.is_dir():
        raise LogError(
            f"{path} is a folder; files are read ({', '.join(SUFFIXES)})",
            cure=f"name the files, say {path}/*.csv; a .zarr log needs no import: pass it to --real-log",
        )
    taken = check_file(path, LogError)
    if path.suffix.lower() not in SUFFIXES:
        kind = f"files that end in {path.suffix!r}" if path.suffix else "files without an ending"
        raise LogError(
            f"{path}: {kind} are not read; {', '.join(SUFFIXES)} are",
            cure="convert it, or rename it to what it is",
        )
    if not taken:
        raise LogError(f"{path} is empty", cure="record it again, or leave it out")
    if taken > (MOST if most is None else most):
        raise _too_large(path, taken, MOST if most is None else most)
    if most is None:
        most = min(max(MOST_OF_FEW, MOST_TIMES * taken), MOST)
    _refuse_other_kinds(path)
    return (ParquetFile if path.suffix.lower() in PARQUET_SUFFIXES else CsvFile)(path, most)


def _refuse_other_kinds(path: Path) -> None:
    """Raise LogError where the file's first bytes say that it is not what its name says."""
    with open_file(path, LogError) as file:
        begin = file.read(8)
    for magic, (kind, cure) in OTHER_KINDS.items():
        if begin.startswith(magic) and not (magic == PARQUET and path.suffix.lower() in PARQUET_SUFFIXES):
            raise LogError(f"{path} is {kind}, by its first bytes", cure=cure)


def _too_large(path: Path, taken: int, most: int) -> LogError:
    return LogError(
        f"{path} takes {size(taken)} in memory, and the most that is read is {size(most)}", cure=LARGER
    )


class CsvFile(SourceFile):
    """Text with a header line; the delimiter is the one the header uses most."""

    def _read_columns(self):
        self._header_line, header = self._first_line()
        self.delimiter = max(DELIMITERS, key=header.count)
        return tuple(name.strip() for name in next(csv.reader([header], delimiter=self.delimiter)))

    def _first_line(self) -> tuple[int, str]:
        """Number (from 0) and text of the first line that is neither blank, nor Excel's `sep=;`, nor a comment.

        But of a comment before a row with numbers in it: that is the header, as of `# t_s,u_N,q_m`.
        """
        comment, self.comments = None, 0
        try:
            with self.path.open(encoding="utf-8-sig") as file:
                for number, line in enumerate(iter(partial(file.readline, LONGEST_LINE), "")):
                    if len(line) == LONGEST_LINE:
                        raise self._long_line(f"line {number + 1}")
                    if not line.strip() or _SEPARATOR.fullmatch(line):
                        continue
                    found = number, line.rstrip("\r\n")
                    if not line.startswith(COMMENTS):
                        break
                    comment, self.comments = found, self.comments + 1
                else:
                    found = comment
        except UnicodeDecodeError as error:
            raise LogError(
                f"{self.path} is not UTF-8 text: {error.reason} at byte {error.start}",
                cure="save it as CSV in UTF-8",
            ) from error
        if found is None:
            raise LogError(f"{self.path} holds blank lines only", cure="record it again, or leave it out")
        if comment is not None and (found is comment or _has_numbers(found[1])):
            self.comments -= 1
            return comment
        return found

    def _long_line(self, where: str) -> LogError:
        return LogError(
            f"{self.path}: {where} has {LONGEST_LINE} characters or more",
            cure="end its lines by line breaks, and its columns by commas, semicolons or tabs",
        )

    def numbers(self, names):
        import pyarrow as pa

        unique = list(dict.fromkeys(names))
        try:
            table = self._read(unique, pa.float64())
        except pa.ArrowInvalid:  # a cell that is not a number as Arrow writes it: read it as text, and see
            table = self._read(unique, pa.string())
        if not table.num_rows:
            raise self._no_rows()
        columns = {name: table[str(self.columns.index(name))] for name in unique}
        if table.schema.types[0] == pa.string():
            columns = self._numbers_of({name: column.to_pylist() for name, column in columns.items()})
        return np.column_stack([columns[name] for name in names])

    def _no_rows(self) -> LogError:
        return LogError(f"{self.path} has a header and no rows", cure="record it again, or leave it out")

    def labels(self, name):
        import pyarrow as pa

        return _texts(self._read([name], pa.string())[0])

    def times(self, name):
        with self.path.open(encoding="utf-8-sig", errors="replace") as file:
            lines = islice(iter(partial(file.readline, LONGEST_LINE), ""), self._header_line + 1, None)
            row = next((line for line in lines if line.strip()), "")
        cells = next(csv.reader([row], delimiter=self.delimiter), [])[self.columns.index(name) :]
        if cells and NUMBER.fullmatch(cells[0].strip()):
            return None  # the file need not be read as text to see that
        return super().times(name)

    def _read(self, names: Sequence[str], kind):
        """An Arrow table whose columns are called by their number, as text: names in files repeat."""
        import pyarrow as pa
        from pyarrow import csv as arrow

        wanted = [str(self.columns.index(name)) for name in names]
        ragged = []
        try:
            return arrow.read_csv(
                self.path,
                # one thread: with several, Arrow does not tell which row is at fault
                read_options=arrow.ReadOptions(
                    column_names=[str(i) for i in range(len(self.columns))],
                    skip_rows=self._header_line + 1,
                    block_size=LONGEST_LINE,
                    use_threads=False,
                ),
                parse_options=arrow.ParseOptions(
                    delimiter=self.delimiter, invalid_row_handler=lambda row: ragged.append(row) or "error"
                ),
                convert_options=arrow.ConvertOptions(
                    column_types=dict.fromkeys(wanted, kind), include_columns=wanted, strings_can_be_null=True
                ),
            )
        except pa.ArrowInvalid as error:
            if ragged:
                raise self._ragged(ragged[0]) from error
            if kind != pa.string():
                raise
            if "Could not skip" in str(error):  # no line follows the header
                raise self._no_rows() from error
            if "straddl" in str(error):  # Arrow's word for a line that is longer than a block of it
                raise self._long_line("a line") from error
            raise LogError(
                f"{self.path} cannot be read as CSV: {error}",
                cure="correct the file, or convert it to Parquet",
            ) from error

    def _ragged(self, row) -> LogError:
        where = "" if row.number is None else f" at {self.place(row.number - self._header_line - 2)}"
        found, expected, text = row.actual_columns, row.expected_columns, row.text
        message = f"{found} value{'s' * (found != 1)}{where}, and the header has {expected}"
        cure = "complete that line, or remove it (the last line of a log that was cut off often needs it)"
        if found > expected:
            cure = "correct that line, or remove it"
        if text.count('"') % 2 or "\n" in text:
            message, cure = f'a quotation mark (") is not closed{where}', QUOTE
        elif text.startswith(COMMENTS):
            cure = "remove that line if it is a comment: only those before the header are passed over"
        elif self._all_have(found):
            message = f"every row has {found} values, and the header has {expected}"
            more = (
                "name the columns that it lacks in the header" if found > expected else "shorten the header"
            )
            cure = f"{more}, or end the rows like it"
            if found == expected + 1 and text.endswith(self.delimiter):
                cure = f"end the header in {self.delimiter!r} as the rows do, or remove it at the end of each row"
        whole = all(WHOLE.fullmatch(value.strip()) for value in text.split(","))
        if self.delimiter == "," and found > expected and whole:
            cure = f"if its numbers have decimal commas: {DECIMAL_COMMAS}; otherwise correct that line"
        return LogError(f"{self.path}: {message}: {text[:60]!r}", cure=cure)

    def _all_have(self, values: int) -> bool:
        """Whether each of the first rows has so many values."""
        with self.path.open(encoding="utf-8-sig", errors="replace") as file:
            rows = [line for line in islice(file, self._header_line + 1, FIRST_ROWS) if line.strip()]
        return all(line.count(self.delimiter) == values - 1 for line in rows)

    def cut_off(self):
        """No line break follows it, and it has fewer decimals than all above it that are near."""
        with self.path.open("rb") as file:
            file.seek(max(0, self.path.stat().st_size - TAIL))
            tail = file.read().decode("utf-8", errors="replace")
        # but for the first, which may be a part, or the header
        lines = [line for line in tail.splitlines()[1:] if line.strip()]
        if tail.endswith(("\n", "\r")) or len(lines) <= FEWEST_ABOVE:
            return None
        values = [row[-1].strip() for row in csv.reader(lines, delimiter=self.delimiter)]
        *above, last = [len(re.sub(r"^[^.,]*[.,]?", "", value)) for value in values]
        return values[-1] if last < min(above, default=0) else None

    def _cure_of_one_column(self, cure):
        return "separate the columns, in all lines, by commas, semicolons or tabs: the first line has none of these"

    def place(self, row):
        """The line, counted from 1 as editors do; blank lines are no rows."""
        with self.path.open(encoding="utf-8-sig", errors="replace") as file:
            lines = (n for n, line in enumerate(file) if n > self._header_line and line.rstrip("\r\n"))
            for index, number in enumerate(lines):
                if index == row:
                    return f"line {number + 1}"
        return f"row {row + 1}"


def _has_numbers(line: str) -> bool:
    """Whether some cell of a CSV's line is a number, whichever the delimiter."""
    return any(NUMBER.fullmatch(cell.strip(' "')) for cell in re.split(f"[{DELIMITERS}]", line))


class ParquetFile(SourceFile):
    """A Parquet file; integers, decimals, booleans and text that is numbers are read as numbers."""

    def _read_columns(self):
        import pyarrow as pa
        from pyarrow import parquet

        try:
            self._file = parquet.ParquetFile(self.path)
            return tuple(self._file.schema_arrow.names)
        except (pa.ArrowException, OSError, UnicodeDecodeError) as error:  # names are text, too
            raise self._unreadable(error) from error

    def _unreadable(self, error: Exception) -> LogError:
        return LogError(f"{self.path} is not a readable Parquet file: {error}", cure="write it again")

    def numbers(self, names):
        table = self._read(list(dict.fromkeys(names)))
        if not table.num_rows:
            raise LogError(f"{self.path} has no rows", cure="record it again, or leave it out")
        texts = {name: table[name].to_pylist() for name in table.column_names if _is_text(table[name].type)}
        columns = self._numbers_of(texts) if texts else {}
        for name in table.column_names:
            if name not in texts:
                columns[name] = self._column(name, table[name])
        return np.column_stack([columns[name] for name in names])

    def labels(self, name):
        import pyarrow as pa

        column = self._read([name])[name]
        try:
            if pa.types.is_nested(column.type):
                raise ValueError("several values are none")
            return _texts(_plain(column))
        except (pa.ArrowException, ValueError) as error:  # Arrow does not do all with every type
            raise LogError(
                f"{self.path}: column {name!r} is of type {column.type}; an episode is told by a text or a number",
                cure="name another column in [log] episode, or write one value into each of its rows",
            ) from error

    def times(self, name):
        from pyarrow import types

        kind = self._file.schema_arrow.field(name).type
        may_be = types.is_timestamp(kind) or types.is_time(kind) or _is_text(kind)
        return super().times(name) if may_be else None

    def place(self, row):
        return f"row {row + 1} (of {self._file.metadata.num_rows})"

    def _read(self, names: list[str]):
        import pyarrow as pa

        try:
            most = max(8 * self._file.metadata.num_rows * len(names), self._packed(names))
        except UnicodeDecodeError as error:
            raise self._unreadable(error) from error
        if most > self.most:
            raise _too_large(self.path, most, self.most)
        try:
            with memory_limit(4 * self.most + WORKING_MEMORY):
                return self._file.read(columns=names, use_threads=False).select(names)
        except MemoryError as error:
            raise LogError(
                f"{self.path}: {', '.join(map(repr, names))} take more memory than {size(4 * self.most)}",
                cure="write long texts in a file of their own, or allow more: --max-log-size 2GB",
            ) from error
        except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
            raise LogError(
                f"{self.path} cannot be read: {error}", cure="the file is damaged: copy or write it again"
            ) from error

    def _column(self, name: str, column) -> np.ndarray:
        import pyarrow as pa

        try:
            return column.cast(pa.float64(), safe=False).to_numpy().astype(float)
        except pa.ArrowException as error:
            raise LogError(
                f"{self.path}: column {name!r} is of type {column.type}, not a number; "
                f"{self.place(0)} holds {_shown(column[0])!r:.60}",
                cure=AS_A_NUMBER,
            ) from error

    def _packed(self, names: Sequence[str]) -> int:
        """Bytes that these columns take in the file, once they are unpacked: at most, where all of it is little.

        Of a damaged chunk of a column Arrow may end the process, so these are looked at only where it matters.
        """
        groups = [self._file.metadata.row_group(k) for k in range(self._file.metadata.num_row_groups)]
        whole = sum(group.total_byte_size for group in groups)
        if 0 <= whole <= self.most:
            return whole
        chunks = (group.column(k) for group in groups for k in range(group.num_columns))
        return sum(c.total_uncompressed_size for c in chunks if c.path_in_schema.split(".")[0] in names)


def _texts(column) -> list[str | None]:
    """A column of Arrow as texts, None where it is empty; those that are the same are kept once."""
    import pyarrow as pa

    chunks = column.chunks if isinstance(column, pa.ChunkedArray) else [column]
    texts: list[str | None] = []
    for chunk in chunks:
        coded = chunk if pa.types.is_dictionary(chunk.type) else chunk.dictionary_encode()
        words = [None if v is None else str(v) for v in coded.dictionary.to_pylist()]
        texts += [None if k is None else words[k] for k in coded.indices.to_pylist()]
    return texts


def _plain(column):
    """A column of Arrow as one of a type that is told by texts in full."""
    import pyarrow as pa

    kind = column.type
    if pa.types.is_float16(kind):
        return column.cast(pa.float32())
    if pa.types.is_duration(kind):
        return column.cast(pa.int64())
    if pa.types.is_timestamp(kind):
        column = column.cast(pa.timestamp(kind.unit))  # in UTC, whatever the zone
    # with ns, which Python's own have not
    return column.cast("string") if pa.types.is_temporal(kind) else column


def _shown(scalar) -> str:
    """A value of Arrow as a text; Python has no duration of some ns."""
    try:
        return str(scalar.as_py())
    except ValueError:
        return f"{scalar.value} {scalar.type.unit}"


def _is_text(kind) -> bool:
    """Whether an Arrow type is that of texts."""
    from pyarrow import types

    return types.is_string(kind) or types.is_large_string(kind)
