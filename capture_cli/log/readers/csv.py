"""CSV: separated by commas, semicolons or tabs."""

import csv
import re
from collections.abc import Sequence
from functools import partial
from itertools import islice

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.errors import LogError
from capture_cli.log.readers._decimal_commas import NUMBER, WHOLE
from capture_cli.log.readers.base import COMMENTS, DECIMAL_COMMAS, QUOTE, SourceFile, texts_of

DELIMITERS = ",;\t"


@frozen
class SETTINGS:
    longest_line: int = 2**20  # characters: a thousand columns take a hundredth
    tail: int = 2**16  # bytes at the end of a file, in which its last line is compared with those before
    fewest_above: int = 10  # lines that the last one is compared with
    first_rows: int = 1000  # lines of a file that are looked at to see whether all have one form


csv.field_size_limit(SETTINGS.longest_line)
_SEPARATOR = re.compile(r'"?sep=.?"?\s*', re.IGNORECASE)  # a first line for Excel, not of the data


class CsvFile(SourceFile):
    """Text with a header line; the delimiter is the one the header uses most."""

    suffixes = (".csv", ".tsv", ".txt")
    cure_of_one_column = (
        "separate the columns, in all lines, by commas, semicolons or tabs: the first line has none of these"
    )

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
                for number, line in enumerate(iter(partial(file.readline, SETTINGS.longest_line), "")):
                    if len(line) == SETTINGS.longest_line:
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
            f"{self.path}: {where} has {SETTINGS.longest_line} characters or more",
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

        return texts_of(self._read([name], pa.string())[0])

    def times(self, name):
        with self.path.open(encoding="utf-8-sig", errors="replace") as file:
            lines = islice(
                iter(partial(file.readline, SETTINGS.longest_line), ""), self._header_line + 1, None
            )
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
                    block_size=SETTINGS.longest_line,
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
            rows = [line for line in islice(file, self._header_line + 1, SETTINGS.first_rows) if line.strip()]
        return all(line.count(self.delimiter) == values - 1 for line in rows)

    def cut_off(self):
        """No line break follows it, and it has fewer decimals than all above it that are near."""
        with self.path.open("rb") as file:
            file.seek(max(0, self.path.stat().st_size - SETTINGS.tail))
            tail = file.read().decode("utf-8", errors="replace")
        # but for the first, which may be a part, or the header
        lines = [line for line in tail.splitlines()[1:] if line.strip()]
        if tail.endswith(("\n", "\r")) or len(lines) <= SETTINGS.fewest_above:
            return None
        values = [row[-1].strip() for row in csv.reader(lines, delimiter=self.delimiter)]
        *above, last = [len(re.sub(r"^[^.,]*[.,]?", "", value)) for value in values]
        return values[-1] if last < min(above, default=0) else None

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
