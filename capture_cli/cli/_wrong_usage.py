"""Faults of a command line: what was found, and the cure."""

import inspect
from collections.abc import Sequence
from typing import Any, get_args, get_type_hints

import typer

from capture_cli.errors import OptionError
from capture_cli.options.base import range_of, short

# of the library that reads options, which typer does not give a name
UsageError = typer.BadParameter.__base__


def wrong_usage(error: UsageError, arguments: Sequence[str]) -> OptionError:
    """What is wrong with the `arguments` of a command, of which the library that reads options says `error`."""
    number = _wrong_number(error, arguments) if isinstance(error, typer.BadParameter) else None
    return number or _otherwise(error)


def _otherwise(error: UsageError) -> OptionError:
    """Its own words: an option or a command that there is not, one that is missing, or has no value."""
    command = "capture" if error.ctx is None else error.ctx.command_path
    lists = "the commands" if command == "capture" else "what it takes"
    found, cure = error.format_message().rstrip("."), f"`{command} --help` lists {lists}"
    if found.endswith("is not readable"):
        cure = "check its permissions, and those of the folders above it"
    return OptionError(found, cure=cure)


def _wrong_number(error: typer.BadParameter, arguments: Sequence[str]) -> OptionError | None:
    """The fault of an option that takes numbers: typer gives neither the value found nor all of the range."""
    if error.param is None or error.ctx is None:
        return None
    name, command = error.param.name, error.ctx.command
    parts = _parts(get_type_hints(inspect.unwrap(command.callback), include_extras=True)[name])
    kind = next((text for kind, text in _NUMBERS.items() if kind in parts), None)
    given, _, _ = command.make_parser(error.ctx).parse_args(args=list(arguments))
    where = "" if name in given else f"--config {error.ctx.params.get('config')}: "
    value = given.get(name, (error.ctx.default_map or {}).get(name))
    if kind is None or value is None:
        return None
    several = isinstance(value, list | tuple)
    found = " ".join(map(str, value)) if several else str(value)
    found = short(found)
    low, high = next((p.min, p.max) for p in parts if hasattr(p, "min") and hasattr(p, "max"))
    cure = f"give {len(value)} numbers" if several else f"give a {kind}{range_of(low, high)}"
    return OptionError(f"{where}{error.param.opts[0]} {found}", cure=cure)


_NUMBERS = {int: "whole number", float: "number"}


def _parts(hint: Any) -> list[Any]:
    """A type hint and what it is made of."""
    return [hint, *(part for piece in get_args(hint) for part in _parts(piece))]
