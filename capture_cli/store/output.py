"""Outputs appear whole or not at all: written beside, synced to disk, renamed into place.

What is written beside is made there by this process: where something of that name is already, be it a link, it is
neither followed nor written to.
"""

import ctypes
import errno
import hashlib
import os
import shutil
import stat
import time
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from capture_cli.common.documents import resolved
from capture_cli.common.frozen import frozen
from capture_cli.common.signals import uninterrupted
from capture_cli.errors import Interrupted, OutputError, StoreError
from capture_cli.store.writer_lock import only_writer

PARTIAL = ".partial-"
REPLACED = ".replaced-"
UNFINISHED = ".unfinished"
NEW = ".new"
PROVENANCE = "provenance.json"


@frozen
class SETTINGS:
    longest: int = 200  # characters of a path in a message
    # s, to remove a folder that something is still written into
    tries: int = 20
    between: float = 0.05
    # AT_FDCWD and RENAME_EXCHANGE of renameat2
    here: int = -100
    exchanged: int = 2


# What a file is by the end of its name, for whoever opens it.
FORMATS = {
    ".csv": "CSV",
    ".html": "HTML",
    ".json": "JSON",
    ".parquet": "Parquet",
    ".png": "PNG",
    ".py": "Python",
    ".toml": "TOML",
    ".xml": "XML",
    ".zarr": "Zarr",
}
GO_ON = "go on with the same command and --resume"
# Outputs that this process has put in place: whoever is interrupted after that is told so.
PLACED: list[Path] = []


@dataclass(frozen=True)
class New:
    """A file, or a folder, that is to appear at `path`."""

    path: Path
    is_folder: bool = False


@contextmanager
def new_outputs(*outputs: New, force: bool, outdated: Sequence[Path] = ()) -> Iterator[list[Path]]:
    """Where to write each of `outputs`; all of them appear in their places when the block ends without an error.

    Until then only hidden siblings exist, so a run that is killed leaves nothing that looks complete; siblings left by
    dead runs are removed by the next one. outdated: files to remove when the new ones are there. Raises OutputError if
    an output exists and `force` is not given (or it is not `capture`'s to replace), if it cannot be written, or if the
    disk is full.
    """
    outputs = tuple(_checked(output, force=force) for output in outputs)
    if len({output.path for output in outputs}) < len(outputs):
        raise OutputError(
            f"two outputs are to be written at {outputs[0].path}", cure="give each of them a path of its own"
        )
    made: list[Path] = []
    at = outputs[0].path
    try:
        for output in outputs:
            at = output.path
            at.parent.mkdir(parents=True, exist_ok=True)
            _remove_leftovers(at)
            with uninterrupted():
                made.append(_made(output))
        yield made
        for partial in made:
            _sync(partial)
        for output in outputs:  # it may have appeared since
            refuse_existing(output.path, force=force)
        with uninterrupted():
            for partial, output in zip(made, outputs, strict=True):
                at = output.path
                _move_into_place(partial, at)
            for path in outdated:
                path.unlink()
    except OSError as error:
        raise _as_output_error(error, at) from error
    finally:
        with uninterrupted():
            for partial in made:
                _remove(partial)


@contextmanager
def new_directory(path: Path, *, force: bool = False) -> Iterator[Path]:
    """A folder to write into that becomes `path`, as `new_outputs` has it."""
    with new_outputs(New(path, is_folder=True), force=force) as (partial,):
        yield partial


def write_texts(texts: Sequence[tuple[Path, str]], *, force: bool, outdated: Sequence[Path] = ()) -> None:
    """Write each text to its path, all of them or none, as `new_outputs` has it."""
    with new_outputs(*(New(path) for path, _ in texts), force=force, outdated=outdated) as files:
        for file, (_, text) in zip(files, texts, strict=True):
            file.write_text(text, encoding="utf-8")


@contextmanager
def resumable_directory(
    path: Path,
    *,
    kept: Callable[[Path], str],
    scaffold: Sequence[str] = (),
    force: bool = False,
    resume: bool = False,
) -> Iterator[Path]:
    """Like `new_directory`, for long work: what can be gone on with stays beside when the block does not end.

    The folder yielded, `.NAME.unfinished`, is empty or, with `resume`, what an earlier run left. kept: of what is in
    it, what can be gone on with, as a sentence without its full stop; "" where nothing can, and then nothing stays.
    scaffold: names in it that are not of the output, nor are those with NEW after them. Raises OutputError where there
    is such a folder and neither `resume` nor `force` is given, or another process is at it; Interrupted where something
    is kept.
    """
    path = _checked(New(path, is_folder=True), force=force).path
    partial = unfinished(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with only_writer(path):
            try:
                _begin(partial, path, kept, force=force, resume=resume)
                yield partial
                _sync(partial)
                refuse_existing(path, force=force)  # it may have appeared since
                with uninterrupted():
                    for name in scaffold:
                        _remove(partial / name)
                        _remove(partial / f"{name}{NEW}")
                    _move_into_place(partial, path)
            except BaseException as error:
                with uninterrupted():
                    left = _left(partial, kept)
                said = _said(error, left, path)
                if said is error:
                    raise
                raise said from error
    except OSError as error:
        raise _as_output_error(error, path) from error


@contextmanager
def renewed(path: Path) -> Iterator[Path]:
    """Where to write what takes the place of `path`, whole or not at all: a run that is killed goes on."""
    beside = path.with_name(f"{path.name}{NEW}")
    yield beside
    beside.replace(path)


def unfinished(path: Path) -> Path:
    """Where `resumable_directory` keeps what is not yet `path`."""
    path = resolved(path)
    return path.with_name(f".{path.name}{UNFINISHED}")


def refuse_existing(path: Path, *, force: bool) -> None:
    """Raise OutputError where `path` exists and may not be replaced, would lie in a file, or goes up by `..` from a
    folder that there is not; call it before any work.

    With `force` a folder is replaced if it is empty or holds a provenance.json, as every output of `capture`
    does: a slip of the hand (`--out . --force`) must not cost a user's own files.
    """
    path = Path(path)
    if path.is_symlink():
        raise OutputError(
            f"{path} is a symbolic link: outputs are not written through one",
            cure="give the path that it points to, or remove the link",
        )
    try:
        there = path.exists()
    except OSError as error:  # a name that is too long
        raise _as_output_error(error, path) from error
    for folder in path.parents:
        if folder.exists() and not folder.is_dir():
            what = "a file" if folder.is_file() else "a device or a pipe"
            raise OutputError(
                f"cannot write {path}: {folder} is {what}, not a folder", cure="choose another --out"
            )
    if not there:
        _refuse_up_from_nothing(path)
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


def refuse_misnamed(path: Path, ending: str, *, option: str = "--out") -> None:
    """Raise OutputError where the file `path`, which is to hold what `ending` of FORMATS says, is named as another.

    option: the one that says where `path` is.
    """
    named = FORMATS.get(Path(path).suffix.lower(), FORMATS[ending])
    if named != FORMATS[ending]:
        raise OutputError(
            f"{option} {path} is named as {named}, and what is written there is {FORMATS[ending]}",
            cure=f"end its name in {ending}",
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
    path = resolved(path)
    for given in (Path(i) for i in inputs if i is not None):
        read = resolved(given)
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
        return _digest(path).hexdigest()
    digest = hashlib.sha256()
    counts = [f for f in path.rglob("*") if f.is_file() and f.name != PROVENANCE]
    for file in sorted(f for f in counts if only is None or f.relative_to(path).as_posix() in only):
        digest.update(os.fsencode(file.relative_to(path).as_posix()) + b"\0")
        digest.update(_digest(file).digest())
    return digest.hexdigest()


def _digest(file: Path):
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256")


def _checked(output: New, *, force: bool) -> New:
    """The output with its whole path. Raises OutputError where it may not be written."""
    refuse_existing(output.path, force=force)
    path = resolved(output.path)
    if output.is_folder and path.is_file():
        raise OutputError(f"{path} is a file; the output is a folder", cure="choose another --out")
    if not output.is_folder and path.is_dir():
        raise OutputError(f"{path} is a folder; the output is a file", cure="choose another --out")
    return New(path, output.is_folder)


def _refuse_up_from_nothing(path: Path) -> None:
    """Raise OutputError where a `..` of `path` follows a folder that there is not.

    The system finds nothing at such a path, even when the output is there that the rest of the path names: what was
    written could not be read by it.
    """
    for number, part in enumerate(path.parts):
        before = Path(*path.parts[:number])
        if part == ".." and not before.is_dir():
            raise OutputError(
                f"cannot write {path}: its `..` goes up from {before}, which does not exist",
                cure=f"leave {before.name}/.. out of the path, or make that folder first",
            )


def _made(output: New) -> Path:
    """A new file or folder beside the output. Raises OSError where something of its name exists."""
    partial = output.path.with_name(f".{output.path.name}{PARTIAL}{os.getpid()}")
    if output.is_folder:
        partial.mkdir()
    else:
        os.close(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    return partial


def _begin(partial: Path, path: Path, kept: Callable[[Path], str], *, force: bool, resume: bool) -> None:
    """Make the folder that is to become `path`, or check that a run can go on in the one that an earlier run left."""
    if partial.is_symlink():
        raise _link(partial)
    if resume and partial.exists():
        _refuse_links(partial)
    elif partial.exists():
        left = "" if force else _left(partial, kept)
        if left:
            raise OutputError(
                f"an earlier run left {path} unfinished (in {partial.name}): {left}",
                cure="go on with it: --resume; or begin anew: --force",
            )
        if partial.exists():
            shutil.rmtree(partial)
    partial.mkdir(exist_ok=True)


def _left(partial: Path, kept: Callable[[Path], str]) -> str:
    """What is kept of a run that has ended early, in words; where that is nothing, its folder is removed."""
    if not partial.exists():
        return ""
    try:
        left = kept(partial)
    except (StoreError, OSError):
        left = "what was written is kept"
    if not left:
        _remove(partial)
    return left


def _said(error: BaseException, left: str, path: Path) -> BaseException:
    """The error by which long work ended, which also names what is `left` of it."""
    if not left or isinstance(error, Interrupted):
        return error
    if isinstance(error, KeyboardInterrupt):
        return Interrupted(f"interrupted: {left}", cure=GO_ON)
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        return OutputError(
            f"the disk is full: {path} is unfinished, and {left}",
            cure="free some space, and go on with --resume",
        )
    return error


def _refuse_links(folder: Path) -> None:
    """Raise OutputError where `folder` holds something that no run of `capture` leaves."""
    for where, folders, files in os.walk(folder):
        for item in (Path(where, name) for name in (*folders, *files)):
            kind = item.lstat().st_mode
            if not (stat.S_ISDIR(kind) or stat.S_ISREG(kind)):
                raise _link(item)


def _link(item: Path) -> OutputError:
    return OutputError(
        f"{item} is a link or something else that no run of `capture` leaves there",
        cure="see where it comes from, and remove it; or choose another --out",
    )


def _remove(item: Path) -> None:
    """Remove a file or a link, or a folder and what is in it, where there is one."""
    if not item.is_dir() or item.is_symlink():
        item.unlink(missing_ok=True)
        return
    for _ in range(SETTINGS.tries):
        shutil.rmtree(item, ignore_errors=True)
        if not item.exists():
            return
        time.sleep(SETTINGS.between)  # a thread of a library is about to end that writes into it


def _remove_leftovers(path: Path) -> None:
    marks = [f".{path.name}{PARTIAL}"]
    # without it a run died just before it put the new one in its place, and the old one is all there is
    if path.exists():
        marks.append(f".{path.name}{REPLACED}")
    for leftover in [item for item in path.parent.iterdir() if item.name.startswith(tuple(marks))]:
        pid = leftover.name.rsplit("-", 1)[-1]
        if pid.isdigit() and not _alive(int(pid)):
            _remove(leftover)


def _alive(pid: int) -> bool:
    if pid == os.getpid():
        return False  # ours, from an earlier attempt in this process
    try:
        with suppress(PermissionError):
            os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def _sync(folder: Path) -> None:
    for item in [folder, *folder.rglob("*")]:
        _sync_item(item)


def _sync_item(item: Path) -> None:
    descriptor = os.open(item, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _move_into_place(partial: Path, path: Path) -> None:
    replaced = path.with_name(f".{path.name}{REPLACED}{os.getpid()}")
    if not path.is_dir():
        partial.replace(path)
    elif _exchange(partial, path):
        partial.rename(replaced)
    else:
        path.rename(replaced)
        try:
            partial.replace(path)
        except OSError:
            replaced.rename(path)
            raise
    # what was placed within it, before it had its name, is a part of it
    PLACED[:] = [*(other for other in PLACED if partial not in other.parents), path]
    _sync_parent(path)
    _remove(replaced)
    _remove_leftovers(path)


def _exchange(one: Path, other: Path) -> bool:
    """Let two folders change places at once, so that there is no moment without either; False where that cannot be."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):  # of Linux alone
        return False
    return (
        renameat2(SETTINGS.here, os.fsencode(one), SETTINGS.here, os.fsencode(other), SETTINGS.exchanged) == 0
    )


def _sync_parent(path: Path) -> None:
    _sync_item(path.parent)


def _as_output_error(error: OSError, path: Path) -> OutputError:
    if error.errno == errno.ENOSPC:
        return OutputError(
            f"the disk is full: {path} was not written", cure="free some space, or choose another --out"
        )
    named = str(path) if len(str(path)) <= SETTINGS.longest else f"{str(path)[: SETTINGS.longest]}..."
    return OutputError(
        f"cannot write {named}: {error.strerror or error}", cure="choose an --out you may write to"
    )
