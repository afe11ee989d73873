"""The `capture` command: all commands together, and how each ends.

stdout carries results only (tables, or with --json exactly one JSON document); progress and messages go to stderr.
Exit codes: 0 done; 1 our fault; 2 the user can mend it; 3 it ran, and the verdict is one named by --fail-on;
128 + the number of the signal that ended it: 130 Ctrl-C, 143 SIGTERM.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from typer.core import TyperCommand, TyperGroup

from capture_cli import __version__
from capture_cli.commands._surroundings import check_surroundings, of_the_system
from capture_cli.commands._wrong_usage import UsageError, wrong_usage
from capture_cli.commands.diagnose import diagnose
from capture_cli.commands.effects import effects
from capture_cli.commands.eval_sim2sim import eval_sim2sim
from capture_cli.commands.export import export
from capture_cli.commands.gen_histories import gen_histories
from capture_cli.commands.identify import identify
from capture_cli.commands.import_log import import_log
from capture_cli.commands.inspect import inspect
from capture_cli.commands.propose import propose
from capture_cli.commands.record import record
from capture_cli.commands.tasks import tasks
from capture_cli.commands.train_policy import train_policy
from capture_cli.commands.train_sysid import train_sysid
from capture_cli.errors import CaptureError, Interrupted, shortened

_COMMANDS = {  # in the order of --help
    "identify": identify,
    "diagnose": diagnose,
    "import-log": import_log,
    "inspect": inspect,
    "record": record,
    "train-policy": train_policy,
    "gen-histories": gen_histories,
    "train-sysid": train_sysid,
    "eval-sim2sim": eval_sim2sim,
    "propose": propose,
    "export": export,
    "tasks": tasks,
    "effects": effects,
}


class _PassedOn(Exception):
    """Carries an exception that typer would turn into an exit code of its own to `main`."""


class _Commands(TyperGroup):
    def make_context(self, info_name, args, parent=None, **extra):
        try:
            return super().make_context(info_name, args, parent, **extra)
        except UsageError as error:
            if not sys.argv[1:]:  # it says what there is
                raise
            raise wrong_usage(error, ()) from None

    def invoke(self, ctx):
        arguments = list(ctx.args)  # of the command; they are taken from there
        try:
            try:
                return super().invoke(ctx)
            finally:
                sys.stdout.flush()
        except (KeyboardInterrupt, BrokenPipeError) as error:
            raise _PassedOn from error
        except UsageError as error:
            raise wrong_usage(error, arguments) from None


class _Command(TyperCommand):
    def invoke(self, ctx):
        check_surroundings()
        if ctx.params.get("config") is not None:
            from capture_cli.stores.output import refuse_inputs

            for name in ("out", "truth"):
                if ctx.params.get(name) is not None:
                    refuse_inputs(ctx.params[name], [ctx.params["config"]], option=f"--{name}")
        return super().invoke(ctx)


app = typer.Typer(
    name="capture",
    cls=_Commands,
    help="Find the parameters of a MuJoCo model from a measured log, and what the model lacks.",
    epilog="Add --debug to any command for a traceback.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
)
for _name, _command in _COMMANDS.items():
    app.command(_name, cls=_Command)(_command)


def main() -> None:
    """Run the command line; every way out has an exit code and, if it is an error, one message."""
    # small matrices by the thousand: more than one thread of linear algebra only spins
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # nothing is rendered, and to look for a window system takes MuJoCo a third of its import
    os.environ.setdefault("MUJOCO_GL", "disable")
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a name that the terminal has no characters for ends nothing
            stream.reconfigure(errors="backslashreplace")
    debug = "--debug" in sys.argv
    arguments = [a for a in sys.argv[1:] if a != "--debug"]
    for stream in ("stdout", "stderr"):
        if getattr(sys, stream) is None:  # closed by the shell, `>&-`
            setattr(sys, stream, Path(os.devnull).open("w"))  # noqa: SIM115
    with _termination_interrupts() as received:
        _run_to_exit(arguments, debug, received)


@contextmanager
def _termination_interrupts() -> Iterator[list[int]]:
    """SIGTERM, by which batch systems and containers end a run, interrupts as Ctrl-C does. Yields where it is noted."""
    received = []

    def interrupt(number: int, _frame: object) -> None:
        # `timeout` sends it twice: the second would end the clearing up
        signal.signal(number, signal.SIG_IGN)
        received.append(number)
        raise KeyboardInterrupt

    before = signal.getsignal(signal.SIGTERM)
    if before is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, interrupt)
    try:
        yield received
    finally:
        if before is signal.SIG_DFL:
            signal.signal(signal.SIGTERM, before)


def _run_to_exit(arguments: list[str], debug: bool, received: list[int]) -> None:
    """Run the command line, and exit as what it raises says. received: numbers of the signals that came."""
    try:
        _run(arguments)
    except CaptureError as error:
        _fail(f"error: {error}", 2, debug)
    except KeyboardInterrupt as error:
        if not isinstance(error, Interrupted):
            error = Interrupted("interrupted: nothing was written", cure="run the same command again")
        _fail(str(error), 128 + (received or [signal.SIGINT])[0], debug)
    except BrokenPipeError:
        _discard_stdout()  # the reader of our pipe went away: nothing is wrong
    except MemoryError:
        _fail(
            "error: out of memory\n  cure: ask for less at once: a shorter log or --duration, fewer --pairs, episodes "
            "or --starts",
            2,
            debug,
        )
    except Exception as error:
        if isinstance(error, OSError) and (of_system := of_the_system(error)):
            if error.filename is None:  # it is stdout that was refused: what is left of it would be, too
                _discard_stdout()
            _fail(f"error: {of_system}", 2, debug)
        _fail(
            f"internal error: {type(error).__name__}: {error}\n  this is a fault of `capture`; --debug shows where",
            1,
            debug,
        )


def _run(arguments: list[str]) -> None:
    """Run the command line. Raises what its commands raise, and SystemExit."""
    try:
        app(arguments, prog_name="capture")
    except _PassedOn as passed:
        raise passed.__cause__ from None
    except SystemExit as ended:
        if isinstance(ended.__context__, BrokenPipeError):  # rich and click make an exit code of 1 of it
            raise ended.__context__ from None
        raise


def _discard_stdout() -> None:
    """Let the rest of stdout, also what is in its buffer, go nowhere."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(message: str, code: int, debug: bool) -> None:
    if debug:
        import traceback

        traceback.print_exc()
    print(shortened(message), file=sys.stderr)
    sys.exit(code)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"capture {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    pass
