"""The `capture` command from its first line to its last, and how it ends.

Exit codes: 0 done; 1 our fault; 2 the user can mend it; 3 it ran, and the verdict is one named by --fail-on;
128 + the number of the signal that ended it: 130 Ctrl-C, 143 SIGTERM.
"""

import errno
import os
import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from capture_cli.common.signals import heed_no_signals, heed_signals, take_as_handled
from capture_cli.errors import CaptureError, Interrupted, shortened


@dataclass(frozen=True)
class _End:
    """How a run ended: its exit code, and its message."""

    code: int
    message: str = ""


def main() -> None:
    """Run the command line; every way out has an exit code and, if it is an error, one message.

    When it returns no signal is heeded any more: what is left is the interpreter's own end.
    """
    received = heed_signals()
    _placed().clear()
    try:
        end = _run(received)
        heed_no_signals()
    except KeyboardInterrupt as error:  # the last moment, or while the message of another end was made
        heed_no_signals()
        end = _interrupted(error, received)
    if end.message:
        print(shortened(end.message), file=sys.stderr)
    sys.exit(end.code)


def _run(received: Sequence[int]) -> _End:
    """Run the command line. received: numbers of the signals that came."""
    # small matrices by the thousand: more than one thread of linear algebra only spins
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # nothing is rendered, and to look for a window system takes MuJoCo a third of its import
    os.environ.setdefault("MUJOCO_GL", "disable")
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a name that the terminal has no characters for ends nothing
            stream.reconfigure(errors="backslashreplace")
    debug = "--debug" in sys.argv
    for stream in ("stdout", "stderr"):
        if getattr(sys, stream) is None:  # closed by the shell, `>&-`
            setattr(sys, stream, Path(os.devnull).open("w"))  # noqa: SIM115
    try:
        from capture_cli.cli.app import run

        run([a for a in sys.argv[1:] if a != "--debug"])
    except SystemExit as ended:
        code = ended.code or 0
    except BaseException as error:
        if debug:
            import traceback

            traceback.print_exc()
        return _ended_by(error, received)
    else:
        code = 0
    if received and code not in (0, 3):  # what a library makes of an interrupt
        return _interrupted(KeyboardInterrupt(), received)
    return _End(code)


def _ended_by(error: BaseException, received: Sequence[int]) -> _End:
    """How a run ends by what it raised."""
    from capture_cli.cli._surroundings import CURES, of_the_system

    # what is interrupted, an import say, may raise something else
    if isinstance(error, KeyboardInterrupt) or received:
        return _interrupted(error, received)
    if isinstance(error, CaptureError):
        return _End(2, f"error: {error}")
    if isinstance(error, BrokenPipeError):
        _discard_stdout()  # the reader of our pipe went away: nothing is wrong
        return _End(0)
    if isinstance(error, MemoryError):
        return _End(2, f"error: out of memory\n  cure: {CURES[errno.ENOMEM]}")
    if isinstance(error, OSError) and (of_system := of_the_system(error)):
        if error.filename is None:  # it is stdout that was refused: what is left of it would be, too
            _discard_stdout()
        return _End(2, f"error: {of_system}")
    return _End(
        1,
        f"internal error: {type(error).__name__}: {error}\n  this is a fault of `capture`; --debug shows where",
    )


def _interrupted(error: BaseException, received: Sequence[int]) -> _End:
    """How a run ends by a signal."""
    take_as_handled()
    code = 128 + (received or [signal.SIGINT])[0]
    if isinstance(error, Interrupted):
        return _End(code, str(error))
    if _placed():
        names = ", ".join(map(str, _placed()))
        return _End(code, f"interrupted when all was written: {names}\n  cure: none is needed, it is whole")
    return _End(code, "interrupted: nothing was written\n  cure: run the same command again")


def _placed() -> list[Path]:
    """The outputs that this run has put in place; none where it has not even imported what does that."""
    return getattr(sys.modules.get("capture_cli.store.output"), "PLACED", [])


def _discard_stdout() -> None:
    """Let the rest of stdout, also what is in its buffer, go nowhere."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
