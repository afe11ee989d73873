"""Signals that end a run: the first interrupts it, and what must not be left half done holds them back.

SIGTERM, by which batch systems and containers end a run, does as Ctrl-C does.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM)


def heed_signals() -> list[int]:
    """Let the signals that end a run raise KeyboardInterrupt; returns where their numbers are noted.

    One that was ignored stays so, as in a shell's background jobs. One that comes where nothing can be raised, as while
    an object is freed, comes again.
    """
    received: list[int] = []
    # s after a signal in which no other is heeded: `timeout` sends it twice, people press Ctrl-C until
    # something happens, and a second one would end the clearing up
    deaf = 10.0
    last = -deaf

    def interrupt(number: int, _frame: FrameType | None) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < deaf:
            return
        last = now
        received.append(number)
        raise KeyboardInterrupt

    soon = 0.05  # s

    def unraisable(swallowed: "sys.UnraisableHookArgs") -> None:
        nonlocal last
        if not (received and swallowed.exc_type is KeyboardInterrupt):
            shown(swallowed)
            return
        last = -deaf
        threading.Timer(soon, os.kill, (os.getpid(), received[-1])).start()

    for number in ENDING:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, interrupt)
    shown, sys.unraisablehook = sys.unraisablehook, unraisable
    return received


def heed_no_signals() -> None:
    """Ignore them from here on: what the run came to is decided, and its message and exit code are to be those."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)


def take_as_handled() -> None:
    """Let Python end with the exit code that it is given, after a KeyboardInterrupt that was handled.

    Where a library ran Python text from C when the signal came, Python takes the exception for one that nobody handled
    and would end itself by SIGINT, whatever the exit code. It forgets that when it is run from C again.
    """
    import ctypes

    ctypes.pythonapi.PyRun_SimpleString(b"")


def end_with_parent(parent: int) -> None:
    """Let this process end when the one that it is a copy of, the process `parent`, does, even by SIGKILL.

    It would go on to write beside an output, and hold its lock. Linux alone can do that.
    """
    import ctypes

    parent_death_signal = 1  # PR_SET_PDEATHSIG of prctl
    try:
        ctypes.CDLL(None).prctl(parent_death_signal, signal.SIGKILL)
    except (AttributeError, OSError, TypeError):
        return
    if os.getppid() != parent:
        os._exit(1)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold signals back while the block runs; one that came meanwhile is heeded when it has ended."""
    if threading.current_thread() is not threading.main_thread():
        yield  # handlers run in the main thread
        return
    held: list[int] = []
    before = {number: signal.getsignal(number) for number in ENDING}
    heeded = {number: handler for number, handler in before.items() if callable(handler)}
    try:
        for number in heeded:
            signal.signal(number, lambda number, _frame: held.append(number))
        yield
    finally:
        for number, handler in heeded.items():
            signal.signal(number, handler)
        if held:
            heeded[held[0]](held[0], None)
