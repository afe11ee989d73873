"""Outputs appear whole or not at all: written beside, synced to disk, renamed into place."""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
from collections.abc import Container, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from capture_cli.errors import Interrupted, OutputError
from capture_cli.stores.writer_lock import only_writer

PARTIAL = ".partial-"
REPLACED = ".replaced-"
UNFINISHED = ".unfinished"
PROVENANCE = "provenance.json"
LONGEST = 200  # characters of a path in a message


@contextmanager
def new_directory(path: Path, *, force: bool = False) -> Iterator[Path]:
    """A folder to write into that becomes `path` when the block ends without an error.

    Until then only a hidden sibling exists, so a run that is killed leaves nothing that looks complete;
    siblings left by dead runs are removed by the next one. Raises OutputError if `path` exists and `force` is
    not given (or the folder is not `capture`'s to replace), if it cannot be written, or if the disk is full.
    """
    path = Path(path).resolve()
    refuse_existing(path, force=force)
    if path.is_file():
        raise OutputError(f"{path} is a file; the output is a folder", cure="choose another --out")
    partial = path.with_name(f".{path.name}{PARTIAL}{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(path)
        partial.mkdir()
        yield partial
        _sync(partial)
        refuse_existing(path, force=force)  # it may have appeared since
        _move_into_place(partial, path)
    except OSError as error:
        raise _as_output_error(error, path) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


@contextmanager
def resumable_directory(path: Path, *, force: bool = False, resume: bool = False) -> Iterator[Path]:
    """Like `new_directory`, for long work: what was written stays beside when the block does not end.

    The folder yielded, `.NAME.unfinished`, is empty or, with `resume`, what an earlier run left. Raises OutputError
    where there is such a folder and neither `resume` nor `force` is given, or another process is at it.
    """
    path = Path(path).resolve()
    refuse_existing(path, force=force)
    if path.is_file():
        raise OutputError(f"{path} is a file; the output is a folder", cure="choose another --out")
    partial = unfinished(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with only_writer(path):
            if partial.exists() and not resume:
                if not force:
                    raise OutputError(
                        f"an earlier run left {path} unfinished (in {partial.name})",
                        cure="go on with it: --resume; or begin anew: --force",
                    )
                shutil.rmtree(partial)
            partial.mkdir(exist_ok=True)
            yield partial
            _sync(partial)
            refuse_existing(path, force=force)  # it may have appeared since
            _move_into_place(partial, path)
    except KeyboardInterrupt as error:
        if isinstance(error, Interrupted) or not partial.exists():
            raise
        raise Interrupted(
            f"interrupted: {path} is unfinished, and what was written is kept",
            cure="go on with the same command and --resume",
        ) from error
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise OutputError(
                f"the disk is full: {path} is unfinished, and what was written is kept",
                cure="free some space, and go on with --resume",
            ) from error
        raise _as_output_error(error, path) from error


def unfinished(path: Path) -> Path:
    """Where `resumable_directory` keeps what is not yet `path`."""
    path = Path(path).resolve()
    return path.with_name(f".{path.name}{UNFINISHED}")


@contextmanager
def new_file(path: Path, *, force: bool = False) -> Iterator[Path]:
    """Like `new_directory`, for one file: write the yielded path, and it becomes `path`."""
    path = Path(path).resolve()
    refuse_existing(path, force=force)
    if path.is_dir():
        raise OutputError(f"{path} is a folder; the output is a file", cure="choose another --out")
    partial = path.with_name(f".{path.name}{PARTIAL}{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(path)
        yield partial
        _sync(partial)
        refuse_existing(path, force=force)
        partial.replace(path)
        _sync_parent(path)
    except OSError as error:
        raise _as_output_error(error, path) from error
    finally:
        partial.unlink(missing_ok=True)


def refuse_existing(path: Path, *, force: bool) -> None:
    """Raise OutputError where `path` exists and may not be replaced, or would lie in a file; call it before any work.

    With `force` a folder is replaced if it is empty or holds a provenance.json, as every output of `capture`
    does: a slip of the hand (`--out . --force`) must not cost a user's own files.
    """
    path = Path(path)
    try:
        there = path.exists()
    except OSError as error:  # a name that is too long
        raise _as_output_error(error, path) from error
    for folder in path.parents:
        if folder.is_file():
            raise OutputError(
                f"cannot write {path}: {folder} is a file, not a folder", cure="choose another --out"
            )
    if not there:
        return
    if not (path.is_file() or path.is_dir()):
        raise OutputError(
            f"{path} is a device or a pipe, not a file or a folder", cure="choose another --out"
        )
    if not force:
        raise OutputError(f"{path} exists already", cure="choose another --out, or add --force to replace it")
    if path.is_dir() and any(path.iterdir()) and not (path / PROVENANCE).is_file():
        raise OutputError(
            f"{path} is not an output of `capture` (no {PROVENANCE} in it), so --force does not replace it",
            cure="choose another --out, or remove the folder yourself",
        )


def is_complete(path: Path, *, force: bool, resume: bool) -> bool:
    """Whether an earlier run made all of `path` and this one resumes it; otherwise as `refuse_existing`."""
    if resume and not force and Path(path).exists():
        return True
    refuse_existing(path, force=force)
    return False


def refuse_inputs(path: Path, inputs: Iterable[Path | str | None], *, option: str = "--out") -> None:
    """Raise OutputError where `path` is one of the inputs, or holds one, or lies inside one: not even --force may cost
    what is read, and a folder with something else in it is another by its hash.

    option: the one that says where `path` is.
    """
    path = Path(path).resolve()
    for given in (Path(i) for i in inputs if i is not None):
        read = given.resolve()
        if path == read or path in read.parents:
            how = "is, or holds,"
        elif read in path.parents:
            how = "is a file of" if path.is_file() else "lies inside"
        else:
            continue
        raise OutputError(f"{option} {path} {how} {given}, which is read", cure=f"choose another {option}")


def sha256(path: Path, only: Container[str] | None = None) -> str:
    """Hash of a file, or of a folder's files with their names (but provenance.json, which holds timings).

    only: names of those that count, where not all do.
    """
    path = Path(path)
    if path.is_file():
        return hashlib.sha256(path.read_bytes()).hexdigest()
    digest = hashlib.sha256()
    counts = [f for f in path.rglob("*") if f.is_file() and f.name != PROVENANCE]
    for file in sorted(f for f in counts if only is None or f.relative_to(path).as_posix() in only):
        digest.update(file.relative_to(path).as_posix().encode() + b"\0")
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


def _remove_leftovers(path: Path) -> None:
    marks = [f".{path.name}{PARTIAL}"]
    # without it a run died just before it put the new one in its place, and the old one is all there is
    if path.exists():
        marks.append(f".{path.name}{REPLACED}")
    for leftover in [item for item in path.parent.iterdir() if item.name.startswith(tuple(marks))]:
        pid = leftover.name.rsplit("-", 1)[-1]
        if pid.isdigit() and not _alive(int(pid)):
            leftover.unlink() if leftover.is_file() else shutil.rmtree(leftover, ignore_errors=True)


def _alive(pid: int) -> bool:
    if pid == os.getpid():
        return False  # ours, from an earlier attempt in this process
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _sync(folder: Path) -> None:
    for item in [folder, *folder.rglob("*")]:
        descriptor = os.open(item, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _move_into_place(partial: Path, path: Path) -> None:
    replaced = path.with_name(f".{path.name}{REPLACED}{os.getpid()}")
    if path.exists():
        path.rename(replaced)
    try:
        partial.rename(path)
    except OSError:
        if replaced.exists():
            replaced.rename(path)
        raise
    _sync_parent(path)
    shutil.rmtree(replaced, ignore_errors=True)
    _remove_leftovers(path)


def _sync_parent(path: Path) -> None:
    descriptor = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _as_output_error(error: OSError, path: Path) -> OutputError:
    if error.errno == errno.ENOSPC:
        return OutputError(
            f"the disk is full: {path} was not written", cure="free some space, or choose another --out"
        )
    named = str(path) if len(str(path)) <= LONGEST else f"{str(path)[:LONGEST]}..."
    return OutputError(
        f"cannot write {named}: {error.strerror or error}", cure="choose an --out you may write to"
    )
