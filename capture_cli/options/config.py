"""`--config`: a TOML whose keys are the defaults of a command's options."""

import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from capture_cli.common.documents import read_toml
from capture_cli.errors import OptionError, did_you_mean


def _read_config(context: typer.Context, path: Path | None) -> Path | None:
    """Make the keys of a TOML the defaults of this command's options."""
    if path is None or context.resilient_parsing:
        return path
    known = _options_of(context.command)
    flags = _names_by_flag(known)
    defaults: dict[str, Any] = {}
    table = read_toml(path, OptionError, called=f"--config {path}")
    for key, value in _of_command(table, flags, context, path).items():
        name = flags.get(key.replace("-", "_"))
        if name is None:
            options = sorted(k.replace("_", "-") for k in flags)
            raise OptionError(
                f"--config {path}: `capture {context.info_name}` has no option {key!r}",
                cure=did_you_mean(key, options),
            )
        defaults[name] = _as_option_takes(known[name], key, value, path)
    context.default_map = defaults
    return path


def _as_option_takes(option: Any, key: str, value: Any, path: Path) -> Any:
    """The value of a key, for the option; one alone is a list of one where the option may be given again and again.

    Raises OptionError for true and false where no switch is, which would be read as 1 and 0, for a switch that is
    neither, and for more or fewer values than the option takes.
    """
    values = value if isinstance(value, list) else [value]
    found = (
        f"--config {path}: {key} = {json.dumps(value, ensure_ascii=False, default=str)}, and {option.opts[0]}"
    )
    if getattr(option, "is_flag", False):
        if not isinstance(value, bool):
            raise OptionError(f"{found} is a switch", cure=f"write {key} = true, or {key} = false")
        return value
    if any(isinstance(v, bool) for v in values):
        cure = f"give it a value, as on the command line, or leave {key} out"
        raise OptionError(f"{found} is no switch", cure=cure)
    if option.nargs < 0 or getattr(option, "multiple", False):
        fits, wanted, example = True, "a list of values", '["VALUE", "VALUE"]'
    elif option.nargs > 1:
        fits, wanted = len(values) == option.nargs, f"{option.nargs} numbers"
        example = f"[{', '.join(['NUMBER'] * option.nargs)}]"
    else:
        fits, wanted, example = value is not values, "one value", "VALUE"
    if not fits or any(isinstance(v, list | dict) for v in values):
        raise OptionError(f"{found} takes {wanted}", cure=f"give {wanted}: {key} = {example}")
    return value if wanted == "one value" else [str(v) for v in values]


def _options_of(command: Any) -> dict[str, Any]:
    """Those that a file may have, by name."""
    return {p.name: p for p in command.params if p.name not in ("config", "help")}


def _names_by_flag(options: Mapping[str, Any]) -> dict[str, str]:
    """The name of each of the options by the flags that it is given with."""
    return {flag.lstrip("-").replace("-", "_"): name for name, p in options.items() for flag in p.opts}


def _of_command(
    table: dict[str, Any], flags: Collection[str], context: typer.Context, path: Path
) -> dict[str, Any]:
    """The keys at the top of the file, but those that other commands alone have, and before them those of this
    command's table; other tables are for others. flags: of this command.

    Raises OptionError for a table that no command is called like.
    """
    commands = context.parent.command.commands if context.parent is not None else {}
    others = {flag for c in commands.values() for flag in _names_by_flag(_options_of(c))} - set(flags)
    tables = {key for key, value in table.items() if isinstance(value, dict)}
    for key in sorted(tables - set(commands) if commands else ()):
        cure = did_you_mean(key, sorted(commands))
        raise OptionError(f"--config {path}: [{key}], and no command is called so", cure=cure)
    own = table[context.info_name] if context.info_name in tables & set(commands) else {}
    top = {key: value for key, value in table.items() if key not in tables & set(commands)}
    return {key: value for key, value in top.items() if key.replace("-", "_") not in others} | own


Config = Annotated[
    Path | None,
    typer.Option(
        "--config", help="TOML with values for any of these options.", callback=_read_config, is_eager=True
    ),
]
