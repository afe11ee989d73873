"""What a Zarr store says of one of its arrays, judged before anything of it is decoded.

Zarr gives what it unpacks to the codecs that the store names; one of them, pickle, runs what a file says. And a store
of a few bytes may say that it holds billions of numbers.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from capture_cli.errors import StoreError
from capture_cli.store.document_shape import COUNT, OBJECT, TEXT, WHOLE, check_shape, or_none

# what only packs numbers, moves them about or sums them up, by Zarr's names for it in version 3 and 2
CODECS = {
    3: ("bytes", "transpose", "zstd", "gzip", "blosc", "crc32c", "sharding_indexed"),
    2: (
        "zstd",
        "gzip",
        "zlib",
        "blosc",
        "lz4",
        "bz2",
        "lzma",
        "delta",
        "shuffle",
        "crc32",
        "crc32c",
        "adler32",
    ),
}
_NUMBERS = re.compile(r"bool|u?int(8|16|32|64)|float(16|32|64)|[<>|=](b1|[iu][1248]|f[248])")
_SHAPE_3 = {
    "shape": [WHOLE],
    "chunk_grid": {"name": TEXT, "configuration": {"chunk_shape": [COUNT]}},
    "codecs": [OBJECT],
}
_SHAPE_2 = {
    "shape": [WHOLE],
    "chunks": [COUNT],
    "compressor?": or_none({"id": TEXT}),
    "filters?": or_none([{"id": TEXT}]),
}
_NESTED = ("codecs", "index_codecs")  # of a shard


@dataclass(frozen=True)
class ArrayMetadata:
    """shape: numbers along each axis. chunks: those in one file. inner: those in one of a file's parts, where it is a
    shard, else `chunks`. codecs: names of all that take part. attributes: unit, meaning.
    """

    zarr_format: int
    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    inner: tuple[int, ...]
    dtype: str
    codecs: tuple[str, ...]
    attributes: Mapping[str, Any]

    @property
    def is_of_numbers(self) -> bool:
        return _NUMBERS.fullmatch(self.dtype) is not None

    @property
    def kind(self) -> str:
        """What its elements are, as numpy calls it; as it is written where they are no numbers."""
        return np.dtype(self.dtype).name if self.is_of_numbers else self.dtype

    @property
    def chunk_count(self) -> int:
        """Files that its numbers are in."""
        return math.prod(-(-n // c) for n, c in zip(self.shape, self.chunks, strict=True))

    @property
    def chunk_bytes(self) -> int:
        """Of a file's numbers, unpacked, with those beyond the ends of the array."""
        return math.prod(self.chunks) * np.dtype(self.dtype).itemsize

    @property
    def nbytes(self) -> int:
        """Of all that is unpacked."""
        return self.chunk_count * self.chunk_bytes

    @property
    def parts(self) -> int:
        """Parts of a file, each of which has an entry in its index."""
        return math.prod(-(-n // c) for n, c in zip(self.chunks, self.inner, strict=True))

    def check(self, where: str, cure: str) -> None:
        """Raise StoreError where it does not hold numbers, or is packed by what is not known to unpack alone."""
        shown = 60  # characters of what was found
        if not self.is_of_numbers:
            raise StoreError(
                f"{where} holds elements of the type {self.dtype:.{shown}}; only numbers are read, and none "
                "that Python would have to build objects of",
                cure="write it again as numbers, say float64",
            )
        known = CODECS[self.zarr_format]
        for codec in self.codecs:
            if codec not in known:
                raise StoreError(
                    f"{where} is packed by {codec!r:.{shown}}, which is not unpacked: it may run what the "
                    "file says",
                    cure=f"write it again without it; what is unpacked: {', '.join(known)}",
                )
        if len(self.chunks) != len(self.shape) or len(self.inner) != len(self.shape):
            raise StoreError(f"{where} has the shape {self.shape} and chunks of {self.chunks}", cure=cure)


def array_metadata(document: Any, attributes: Mapping[str, Any], where: str, cure: str) -> ArrayMetadata:
    """What the metadata `document` of an array says. Raises StoreError, with `cure`, where it does not say it."""
    check_shape(document, OBJECT, where, cure)
    if document.get("zarr_format") == 2:
        check_shape(document, _SHAPE_2, where, cure)
        packed = [document.get("compressor"), *(document.get("filters") or [])]
        chunks = tuple(document["chunks"])
        inner, codecs, dtype = chunks, tuple(c["id"] for c in packed if c), document.get("dtype")
    else:
        check_shape(document, _SHAPE_3, where, cure)
        chunks = tuple(document["chunk_grid"]["configuration"]["chunk_shape"])
        codecs, inner = _unpacked(document["codecs"], chunks, where, cure)
        dtype = document.get("data_type")
    return ArrayMetadata(
        zarr_format=2 if document.get("zarr_format") == 2 else 3,
        shape=tuple(document["shape"]),
        chunks=chunks,
        inner=inner,
        dtype=dtype if isinstance(dtype, str) else repr(dtype),
        codecs=codecs,
        attributes=attributes,
    )


def _unpacked(
    rows: list[dict[str, Any]], chunks: tuple[int, ...], where: str, cure: str
) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Names of the codecs of a version 3 array, those within shards too, and how many numbers a part of a file has."""
    names: list[str] = []
    inner = chunks
    for row in rows:
        check_shape(row, {"name": TEXT, "configuration?": or_none(OBJECT)}, f"{where}: codecs", cure)
        names.append(row["name"])
        given = row.get("configuration") or {}
        if row["name"] == "sharding_indexed":
            check_shape(given, {"chunk_shape": [COUNT], "codecs": [OBJECT]}, f"{where}: sharding", cure)
            inner = tuple(given["chunk_shape"])
            for part in _NESTED:
                names += _unpacked(given.get(part) or [], chunks, where, cure)[0]
    return tuple(names), inner
