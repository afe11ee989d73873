"""Parquet."""

from collections.abc import Sequence

import numpy as np

from capture_cli.errors import LogError
from capture_cli.log.readers.base import AS_A_NUMBER, SourceFile, texts_of, too_large
from capture_cli.store.memory_limit import memory_limit
from capture_cli.store.zarr_store import SETTINGS as ZARR_STORE
from capture_cli.store.zarr_store import size


class ParquetFile(SourceFile):
    """A Parquet file; integers, decimals, booleans and text that is numbers are read as numbers."""

    suffixes = (".parquet", ".pq")
    magic = b"PAR1"

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
            return texts_of(_plain(column))
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
            raise too_large(self.path, most, self.most)
        try:
            with memory_limit(4 * self.most + ZARR_STORE.working_memory):
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
