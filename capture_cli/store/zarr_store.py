"""A Zarr store of any writer on disk: its metadata are read as documents, and judged, before Zarr opens an array."""

import os
import shlex
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.common.documents import exists, read_json, unreadable
from capture_cli.common.frozen import frozen
from capture_cli.errors import StoreError
from capture_cli.store.array_metadata import ArrayMetadata, array_metadata
from capture_cli.store.document_shape import OBJECT, check_shape
from capture_cli.store.memory_limit import memory_limit

MAKE_AGAIN = "the store is damaged: copy it again, or make it again with the command that wrote it"
ROOT, OLD_GROUP, OLD_ARRAY, OLD_ATTRIBUTES = "zarr.json", ".zgroup", ".zarray", ".zattrs"
READ_IN = "a log is read in by `capture import-log FILE --task task.toml --out LOG.zarr`"
METADATA = (ROOT, OLD_GROUP, OLD_ARRAY, OLD_ATTRIBUTES, ".zmetadata")


@frozen
class SETTINGS:
    most: int = 500_000_000  # bytes: a million steps of sixty channels
    # bytes unpacked that few on disk may be: what comes next takes several times as much
    most_of_few: int = 100_000_000
    # of what it takes on disk: motion halves, and what stands still is packed a hundredfold
    most_times: int = 50
    most_chunks: int = 100_000  # files of an array: read in seconds, and of 4 MB each more than a disk holds
    most_nodes: int = 10_000  # groups and arrays that are listed
    index_entry: int = 16  # bytes, of each part in the index of a shard
    room: int = 1 << 16  # bytes of a file besides its numbers
    # bytes: what unpacking takes besides the numbers themselves and a copy of them
    working_memory: int = 300_000_000


class ZarrStore:
    """The store in the folder `path`. attributes: those of its root. made_by: what to do where it is something else.

    Raises StoreError where there is none, or its metadata are damaged.
    """

    def __init__(self, path: Path, made_by: str = READ_IN):
        self.path = Path(path)
        if not exists(self.path, StoreError):
            raise StoreError(f"{path} does not exist", cure="check the path")
        if not self.path.is_dir():
            raise StoreError(
                f"{path} is a file, not a Zarr store",
                cure=f"read it in first: `capture import-log {shlex.quote(str(path))} --task task.toml "
                f"--out {shlex.quote(self.path.stem)}.zarr`",
            )
        found = self._node("")
        if found is None or not found[0]:
            raise StoreError(
                f"{path} is not a readable Zarr group: there is no {ROOT} or {OLD_GROUP} of a group in it",
                cure=f"check the path; {made_by}",
            )
        _, _, self.attributes = found

    def metadata(self, name: str) -> ArrayMetadata | None:
        """Of the array called `name`; None where there is none. Raises StoreError where they are damaged."""
        found = self._node(name)
        if found is None or found[0]:
            return None
        _, document, attributes = found
        return array_metadata(document, attributes, f"{self.path}: the metadata of {name}", MAKE_AGAIN)

    def names(self) -> list[str]:
        """Of all arrays, at any depth. Raises StoreError where metadata are damaged."""
        names, groups = [], [""]
        while groups:
            group = groups.pop()
            for folder in sorted((self.path / group).iterdir()):
                name = folder.relative_to(self.path).as_posix()
                if not folder.is_dir() or (found := self._node(name)) is None:
                    continue
                (groups if found[0] else names).append(name)
                if len(names) + len(groups) > SETTINGS.most_nodes:
                    raise StoreError(
                        f"{self.path} has more than {SETTINGS.most_nodes} arrays", cure=MAKE_AGAIN
                    )
        return sorted(names)

    def read(
        self, arrays: Mapping[str, ArrayMetadata], most: int | None = None, larger: str = MAKE_AGAIN
    ) -> dict[str, np.ndarray]:
        """The arrays with these metadata, by name. most: bytes, unpacked; `most_of_few` where None, or `most_times`
        of what they take on disk. larger: the cure where there are more.

        Raises StoreError before any is unpacked where there would be more, or they are no numbers; and where one is
        truncated or damaged.
        """
        on_disk = 0
        for name, found in arrays.items():
            count, taken = self._check(name, found)
            if count < found.chunk_count:
                raise self._truncated(name, count, found.chunk_count)
            on_disk += taken
        unpacked = sum(found.nbytes for found in arrays.values())
        limit = max(SETTINGS.most_of_few, SETTINGS.most_times * on_disk) if most is None else most
        if unpacked > limit:
            raise StoreError(
                f"{self.path} takes {size(unpacked)} in memory, {size(on_disk)} on disk; the most that is read "
                f"is {size(limit)}",
                cure=larger,
            )
        with memory_limit(2 * unpacked + SETTINGS.working_memory):
            return {name: self._unpacked(name, found) for name, found in arrays.items()}

    def open(self, name: str):
        """The Zarr array called `name`, which is there, checked. Raises StoreError where it must not be read."""
        found = self.metadata(name)
        self._check(name, found)
        if found.chunk_bytes > SETTINGS.most:
            raise StoreError(
                f"{self.path}: {name} has files of {size(found.chunk_bytes)} unpacked; {size(SETTINGS.most)} are "
                "the most",
                cure=MAKE_AGAIN,
            )
        return self._opened(name, found)

    def _check(self, name: str, found: ArrayMetadata) -> tuple[int, int]:
        """How many files an array has, and their bytes. Raises StoreError where they are not what its metadata say."""
        where = f"{self.path}: {name}"
        found.check(where, MAKE_AGAIN)
        if found.chunk_count > SETTINGS.most_chunks:
            raise StoreError(
                f"{where} is in {found.chunk_count} chunks, and {SETTINGS.most_chunks} are the most that is read",
                cure="write it again in larger chunks",
            )
        index = SETTINGS.index_entry * found.parts
        largest = found.chunk_bytes + found.chunk_bytes // 8 + 2 * index + SETTINGS.room
        count = total = 0
        for file, taken in _files(self.path / name, len(found.shape) + 1):
            if taken > largest:
                raise StoreError(
                    f"{file} has {size(taken)}, and its numbers take {size(found.chunk_bytes)}",
                    cure=MAKE_AGAIN,
                )
            if found.inner != found.chunks and taken < index:
                raise StoreError(
                    f"{file} has {taken} bytes, too few for the index of its {found.parts} parts",
                    cure=MAKE_AGAIN,
                )
            count, total = count + 1, total + taken
        return count, total

    def _unpacked(self, name: str, found: ArrayMetadata) -> np.ndarray:
        array = self._opened(name, found)
        try:
            whole = array.nchunks_initialized
            if whole < array.nchunks:
                raise self._truncated(name, whole, array.nchunks)
            with _without_warnings():
                return np.asarray(array[...])
        except StoreError:
            raise
        except PermissionError as error:
            raise unreadable(f"{self.path}: {name}: {error.filename}", error, StoreError) from error
        except MemoryError as error:
            raise StoreError(
                f"{self.path}: {name} unpacks to more than the {size(found.nbytes)} that its metadata say",
                cure=MAKE_AGAIN,
            ) from error
        except Exception as error:  # whatever a codec raises on damaged bytes
            raise StoreError(f"{self.path}: {name} cannot be decoded: {error}", cure=MAKE_AGAIN) from error

    def _opened(self, name: str, found: ArrayMetadata):
        import zarr

        try:
            with _without_warnings():
                return zarr.open_array(str(self.path), path=name, mode="r", zarr_format=found.zarr_format)
        except Exception as error:  # key, type and codec errors, by what is damaged
            raise StoreError(
                f"{self.path}: the metadata of {name} cannot be read: {type(error).__name__}: {error}",
                cure=MAKE_AGAIN,
            ) from error

    def _truncated(self, name: str, found: int, chunks: int) -> StoreError:
        return StoreError(
            f"{self.path}: {name} has {found} of its {chunks} chunks: it is truncated",
            cure=f"{MAKE_AGAIN} (another program that writes one must write empty chunks too)",
        )

    def _node(self, name: str) -> tuple[bool, dict[str, Any], dict[str, Any]] | None:
        """Whether a node is a group, its metadata and its attributes; None where there is none. Raises StoreError."""
        folder = self.path / name
        if exists(folder / ROOT, StoreError):
            document = self._document(folder / ROOT)
            attributes = document.get("attributes", {})
            check_shape(attributes, OBJECT, folder / ROOT, MAKE_AGAIN)
            return document.get("node_type") == "group", document, attributes
        for kind in (OLD_ARRAY, OLD_GROUP):
            if exists(folder / kind, StoreError):
                document = self._document(folder / kind)
                beside = folder / OLD_ATTRIBUTES
                return (
                    kind == OLD_GROUP,
                    document,
                    self._document(beside) if exists(beside, StoreError) else {},
                )
        return None

    def _document(self, path: Path) -> dict[str, Any]:
        found = read_json(path, StoreError, cure=MAKE_AGAIN)
        check_shape(found, OBJECT, path, MAKE_AGAIN)
        return found


@contextmanager
def _without_warnings() -> Iterator[None]:
    """Hide warnings of Zarr and numpy: errors say what is wrong with an array."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def size(count: float) -> str:
    """So many bytes in the largest unit of which they are at least one: "1.6 GB"."""
    number, unit = float(count), "B"
    for larger in ("kB", "MB", "GB", "TB"):
        if number < 1000:
            break
        number, unit = number / 1000, larger
    return f"{number:.3g} {unit}"


def _files(folder: Path, depth: int) -> Iterator[tuple[Path, int]]:
    """The files of an array, which lie at most `depth` folders down, with their bytes. Raises StoreError for what is
    neither a file nor a folder: to read a pipe is to wait for ever.
    """
    try:
        entries: Iterable[os.DirEntry] = list(os.scandir(folder))
    except OSError as error:
        raise StoreError(
            f"{folder} cannot be listed: {error.strerror}", cure="check its permissions"
        ) from error
    for entry in entries:
        if entry.name in METADATA:
            continue
        if entry.is_file():
            yield Path(entry.path), entry.stat().st_size
        elif entry.is_dir():
            if depth:
                yield from _files(Path(entry.path), depth - 1)
        else:
            raise StoreError(f"{entry.path} is neither a file nor a folder", cure=MAKE_AGAIN)
