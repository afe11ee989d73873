"""One writer at a time: a lock beside an output, which the system gives up when its process ends, however that is."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from capture_cli.errors import OutputError

try:
    import fcntl
except ImportError:  # not on this system: then nobody is kept out
    fcntl = None

LOCK = ".lock"


@contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Hold the lock `.NAME.lock` beside `path`, whose folder exists, while the block runs.

    Raises OutputError, naming the process, where another one holds it. A file system without locks keeps nobody out.
    """
    path = Path(path).resolve()
    lock = path.with_name(f".{path.name}{LOCK}")
    descriptor = None if fcntl is None else _locked(lock, path)
    try:
        yield
    finally:
        if descriptor is not None:
            lock.unlink(missing_ok=True)  # while it is held: who waits for it then sees that it is gone
            fcntl.flock(descriptor, fcntl.LOCK_UN)  # also for children that inherited it
            os.close(descriptor)


def _locked(lock: Path, path: Path) -> int | None:
    """A descriptor of `lock`, which is held; None where the file system has no locks."""
    while True:
        try:
            descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o644)
        except PermissionError:
            return None  # nothing can be written here: who tries says so
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(descriptor, 200).decode() or "another process"
            os.close(descriptor)
            raise OutputError(f"{holder} is writing {path}", cure="wait until it ends, or stop it") from None
        except OSError:
            os.close(descriptor)
            lock.unlink(missing_ok=True)
            return None
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), lock.stat()):
                os.ftruncate(descriptor, 0)
                now = datetime.now(UTC).isoformat(timespec="seconds")
                os.write(
                    descriptor, f"process {os.getpid()} on {socket.gethostname()}, since {now},".encode()
                )
                return descriptor
        os.close(descriptor)  # of a file that its holder has removed
