"""Files that logs come in, as columns of numbers. One format = one file.

In: the path of a file. Out: a `SourceFile`, which has the names of its columns and reads those that are asked for.
"""

from pathlib import Path

from capture_cli.common.documents import check_file, open_file
from capture_cli.common.registry import Registry
from capture_cli.errors import LogError
from capture_cli.log.readers.base import SourceFile, too_large
from capture_cli.store.zarr_store import SETTINGS as ZARR_STORE

REGISTRY: Registry[SourceFile] = Registry("capture_cli.log.readers", "SourceFile", "file format")
OTHER_KINDS = {  # by the first bytes: what it is, and the cure
    b"PAR1": ("a Parquet file", "rename it to end in .parquet"),
    b"PK\x03\x04": ("a zip archive or an Excel workbook", "unpack it; of a workbook, save its sheet as CSV"),
    b"\x1f\x8b": ("compressed by gzip", "unpack it (gunzip), and name what it holds .csv or .parquet"),
    b"(\xb5\x2f\xfd": ("compressed by zstd", "unpack it (unzstd), and name what it holds .csv or .parquet"),
    b"\x89HDF": ("an HDF5 file", "convert its columns to CSV or Parquet"),
    b"\x89MCAP": ("an MCAP recording", "convert its topics to CSV or Parquet"),
    b"#ROSBAG": ("a ROS bag", "convert its topics to CSV or Parquet"),
}


def readers() -> dict[str, type[SourceFile]]:
    """Who reads a file, by what its name ends in."""
    return {suffix: reader for _, reader in REGISTRY.items() for suffix in reader.suffixes}


def open_source(path: Path, most: int | None = None) -> SourceFile:
    """The file at `path`, which may take `most` bytes; where None `most`, or less of one that has few bytes.

    Raises LogError where it is missing, empty, too large, or of a kind that is not read.
    """
    path = Path(path)
    known = readers()
    if path.is_dir():
        raise LogError(
            f"{path} is a folder; files are read ({', '.join(known)})",
            cure=f"name the files, say {path}/*.csv; a .zarr log needs no import: pass it to --real-log",
        )
    taken = check_file(path, LogError)
    if path.suffix.lower() not in known:
        kind = f"files that end in {path.suffix!r}" if path.suffix else "files without an ending"
        raise LogError(
            f"{path}: {kind} are not read; {', '.join(known)} are",
            cure="convert it, or rename it to what it is",
        )
    if not taken:
        raise LogError(f"{path} is empty", cure="record it again, or leave it out")
    if taken > (ZARR_STORE.most if most is None else most):
        raise too_large(path, taken, ZARR_STORE.most if most is None else most)
    if most is None:
        most = min(max(ZARR_STORE.most_of_few, ZARR_STORE.most_times * taken), ZARR_STORE.most)
    reader = known[path.suffix.lower()]
    _refuse_other_kinds(path, reader)
    return reader(path, most)


def _refuse_other_kinds(path: Path, reader: type[SourceFile]) -> None:
    """Raise LogError where the file's first bytes say that it is not what its name says."""
    with open_file(path, LogError) as file:
        begin = file.read(8)
    for magic, (kind, cure) in OTHER_KINDS.items():
        if begin.startswith(magic) and magic != reader.magic:
            raise LogError(f"{path} is {kind}, by its first bytes", cure=cure)
