"""All commands together.

stdout carries results only (tables, or with --json exactly one JSON document); progress and messages go to stderr.
"""

import importlib
import pkgutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer
from typer.core import TyperCommand, TyperGroup

from capture_cli import __version__
from capture_cli.cli._surroundings import check_surroundings
from capture_cli.cli._wrong_usage import UsageError, wrong_usage
from capture_cli.common.registry import with_first
from capture_cli.options.base import on_command_line

_NO_COMMANDS = ("app", "program")
_FIRST = (  # in this order in --help, before those of other files
    "identify",
    "diagnose",
    "draft-task",
    "import-log",
    "inspect",
    "record",
    "train-policy",
    "gen-histories",
    "train-sysid",
    "eval-sim2sim",
    "propose",
    "export",
    "tasks",
    "effects",
)


def _commands() -> dict[str, Callable[..., None]]:
    """Every command by its name: the function in a module of this folder that has the module's name."""
    stems = [m.name for m in pkgutil.iter_modules([str(Path(__file__).parent)]) if not m.name.startswith("_")]
    names = {stem.replace("_", "-"): stem for stem in stems if stem not in _NO_COMMANDS}
    return {
        name: getattr(importlib.import_module(f"{__package__}.{names[name]}"), names[name])
        for name in with_first(names, _FIRST)
    }


_COMMANDS = _commands()


class _PassedOn(Exception):
    """Carries an exception that typer would turn into an exit code of its own to `run`."""


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
            from capture_cli.store.output import refuse_inputs

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
    app.command(_name, cls=_Command)(on_command_line(_command))


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


def run(arguments: Sequence[str]) -> None:
    """Run the command line. Raises what its commands raise, and SystemExit."""
    try:
        app(arguments, prog_name="capture")
    except _PassedOn as passed:
        raise passed.__cause__ from None
    except SystemExit as ended:
        if isinstance(ended.__context__, BrokenPipeError):  # rich and click make an exit code of 1 of it
            raise ended.__context__ from None
        raise
