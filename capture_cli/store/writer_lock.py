"""One writer at a time: a lock beside an output, which the system gives up when its process ends, however that is.

A lock is a file that its holder made; one that lies there already is never written to, be it a lock of a dead run, a
file of somebody's, or a link to one. (The package filelock takes as much care, but leaves its file behind and does not
say who holds it.)
"""

import os
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from capture_cli.common.documents import resolved
from capture_cli.errors import OutputError

try:
    import fcntl
except ImportError:  # not on this system: then nobody is kept out
    fcntl = None

LOCK, HOLDER = ".lock", "process "  # how what a lock says of its holder begins


@contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Hold the lock `.NAME.lock` beside `path`, whose folder exists, while the block runs.

    Raises OutputError where another process holds it, which is named, or where something that is no lock lies in its
    place. A file system without locks keeps nobody out.
    """
    path = resolved(path)
    lock = path.with_name(f".{path.name}{LOCK}")
    descriptor = None if fcntl is None else _held(lock, path)
    try:
        yield
    finally:
        if descriptor is not None:
            lock.unlink(missing_ok=True)  # while it is held: who waits for it then sees that it is gone
            fcntl.flock(descriptor, fcntl.LOCK_UN)  # also for children that inherited it
            os.close(descriptor)


def _held(lock: Path, path: Path) -> int | None:
    """A descriptor of `lock`, which was made and is held; None where nothing can be written or locked here."""
    while True:
        try:
            descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o644)
        except FileExistsError:
            _remove_left(lock, path)
            continue
        except PermissionError:
            return None  # who tries to write says so
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            continue  # somebody took it for one that was left, and is about to remove it
        except OSError:
            os.close(descriptor)
            lock.unlink(missing_ok=True)
            return None
        if _is_at(lock, descriptor):
            now = datetime.now(UTC).isoformat(timespec="seconds")
            os.write(descriptor, f"{HOLDER}{os.getpid()} on {socket.gethostname()}, since {now},".encode())
            return descriptor
        os.close(descriptor)


def _remove_left(lock: Path, path: Path) -> None:
    """Remove a lock that no process holds. Raises OutputError where one does, or where it is no lock."""
    try:
        # not waiting for the other end of a pipe
        descriptor = os.open(lock, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return
    except OSError as error:
        raise _no_lock(lock) from error
    longest_holder = 200  # bytes
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise _no_lock(lock)
        holder = os.read(descriptor, longest_holder).decode(errors="replace")
        if not holder.startswith(HOLDER[: len(holder)]):
            raise _no_lock(lock)
        with suppress(OSError):  # a file system without locks
            _lock(descriptor, holder, path)
        if _is_at(lock, descriptor):  # not one that was made since
            lock.unlink()
    finally:
        os.close(descriptor)


def _lock(descriptor: int, holder: str, path: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise OutputError(
            f"{holder or 'another process'} is writing {path}", cure="wait until it ends, or stop it"
        ) from None


def _is_at(lock: Path, descriptor: int) -> bool:
    """Whether the file that is open is the one at `lock`."""
    with suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(descriptor), lock.lstat())
    return False


def _no_lock(lock: Path) -> OutputError:
    return OutputError(
        f"{lock} is in the way: it is not the lock of a run but a link, a folder or another file, or may not be read",
        cure="see what it is, and remove it; or choose another --out",
    )
