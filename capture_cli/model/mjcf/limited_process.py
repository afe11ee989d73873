"""Work on what a stranger may have made, in a copy of this process that may take so much time and memory, no more."""

import faulthandler
import json
import math
import os
import select
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from capture_cli import errors
from capture_cli.common.frozen import frozen

if sys.platform != "win32":
    import resource

# Elsewhere a process that has threads is not copied safely.
CAN_LIMIT = sys.platform == "linux"


@frozen
class SETTINGS:
    grace: int = 1  # s of CPU time after which a process is killed that does not end when it is told to
    piece: int = 1 << 20  # bytes that are read at once


_DONE, _REFUSED, _FAILED = b"\0", b"\1", b"\2"  # what the first byte of an answer says


class Exceeded(Exception):
    """The work did not end within its limits: what it took, as the end of a sentence."""


def limited(work: Callable[[], bytes], *, seconds: float, memory: int) -> bytes:
    """What `work` returns, done in a process of its own that ends after so many `seconds`, or with it.

    memory: bytes that it may take beside what this process has. A CaptureError that it raises is raised here. Exceeded
    where it takes more, or ends otherwise: whatever it is that MuJoCo does there, this process goes on.

    A copy of this process takes some milliseconds, a new one would take MuJoCo's import. Where CAN_LIMIT is False the
    work is done here, without limits.
    """
    if not CAN_LIMIT:
        return work()
    end, own_end = os.pipe()
    child = os.fork()
    if not child:
        _work_and_exit(work, own_end, seconds, memory)
    os.close(own_end)
    try:
        answer = _answer(end, time.monotonic() + seconds)
    except TimeoutError:
        raise Exceeded(f"takes more than {seconds:g} s") from None
    finally:
        os.close(end)
        os.kill(child, signal.SIGKILL)  # it is done, or has to be
        _, status = os.waitpid(child, 0)
    return _read(answer, status, seconds, memory)


def _answer(end: int, deadline: float) -> bytes:
    """All that comes through the pipe until its other end is closed. Raises TimeoutError."""
    pieces = []
    while True:
        ready, _, _ = select.select([end], [], [], max(deadline - time.monotonic(), 0.0))
        if not ready:
            raise TimeoutError
        piece = os.read(end, SETTINGS.piece)
        if not piece:
            return b"".join(pieces)
        pieces.append(piece)


def _read(answer: bytes, status: int, seconds: float, memory: int) -> bytes:
    """The result in the answer of a process that ended with this status."""
    kind, rest = answer[:1], answer[1:]
    if kind == _DONE:
        return rest
    if kind == _REFUSED:
        name, message, cure = json.loads(rest)
        raise getattr(errors, name)(message, cure=cure)
    if kind == _FAILED:
        raise Exceeded(rest.decode() or f"takes more than {memory / (1 << 30):.2g} GB of memory")
    number = os.waitstatus_to_exitcode(status)
    if number == -signal.SIGXCPU:
        raise Exceeded(f"takes more than {seconds:g} s")
    raise Exceeded(f"ends the process ({signal.Signals(-number).name})" if number < 0 else "ends the process")


def _work_and_exit(work: Callable[[], bytes], end: int, seconds: float, memory: int) -> NoReturn:
    """What the copy of the process does: no more than this, whatever happens."""
    try:
        for piece in _answered(work, seconds, memory):
            _write(end, piece)
    finally:
        os._exit(0)


def _answered(work: Callable[[], bytes], seconds: float, memory: int) -> tuple[bytes, bytes]:
    try:
        _be_alone()
        _limit(seconds, memory)
        return _DONE, work()
    except errors.CaptureError as error:
        return _REFUSED, json.dumps([type(error).__name__, error.message, error.cure]).encode()
    except MemoryError:
        return _FAILED, b""
    except Exception as error:
        return _FAILED, f"fails with {type(error).__name__}: {error}".encode(errors="replace")


def _be_alone() -> None:
    """Say nothing, and leave signals and what is open to the process that this one is a copy of."""
    faulthandler.disable()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nowhere, stream)


def _limit(seconds: float, memory: int) -> None:
    processor = math.ceil(seconds)
    for limit, most in (
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_CPU, processor),
        (resource.RLIMIT_DATA, bytes_taken() + memory),
    ):
        _, hard = resource.getrlimit(limit)
        highest = most + SETTINGS.grace if limit == resource.RLIMIT_CPU else most
        if hard != resource.RLIM_INFINITY:
            most, highest = min(most, hard), min(highest, hard)
        with suppress(ValueError, OSError):  # a system that does not let one has limits of its own
            resource.setrlimit(limit, (most, highest))


def bytes_taken() -> int:
    """Bytes of data and stack that this process has."""
    pages = int(Path("/proc/self/statm").read_text().split()[5])
    return pages * os.sysconf("SC_PAGE_SIZE")


def _write(end: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(end, view) :]
