"""`--config`: a TOML whose keys are the defaults of a command's options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from capture_cli.errors import OptionError, did_you_mean


def _read_config(context: typer.Context, path: Path | None) -> Path | None:
    """Make the keys of a TOML the defaults of this command's options."""
    if path is None or context.resilient_parsing:
        return path
    import tomllib

    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise OptionError(f"--config {path}: {error}", cure="give a readable TOML file") from error
    table = _of_command(table, context)
    known = {p.name: p for p in context.command.params if p.name not in ("config", "help")}
    flags = {option.lstrip("-").replace("-", "_"): name for name, p in known.items() for option in p.opts}
    defaults: dict[str, Any] = {}
    for key, value in table.items():
        name = flags.get(key.replace("-", "_"))
        if name is None:
            options = sorted(k.replace("_", "-") for k in flags)
            raise OptionError(
                f"--config {path}: `capture {context.info_name}` has no option {key!r}",
                cure=did_you_mean(key, options),
            )
        _refuse_switch(known[name], key, value, path)
        defaults[name] = [str(v) for v in value] if isinstance(value, list) else value
    context.default_map = defaults
    return path


def _refuse_switch(option: Any, key: str, value: Any, path: Path) -> None:
    """Raise OptionError where an option that takes a value is given true or false, which would be read as 1 or 0."""
    given = value if isinstance(value, list) else [value]
    if getattr(option, "is_flag", False) or not any(isinstance(v, bool) for v in given):
        return
    raise OptionError(
        f"--config {path}: {key} = {str(value).lower()}, and {option.opts[0]} is no switch",
        cure=f"give it a value, as on the command line, or leave {key} out",
    )


def _of_command(table: dict[str, Any], context: typer.Context) -> dict[str, Any]:
    """The keys at the top of the file, and before them those of this command's table; other tables are for others."""
    commands = context.parent.command.commands if context.parent is not None else {}
    tables = {key for key, value in table.items() if key in commands and isinstance(value, dict)}
    own = table[context.info_name] if context.info_name in tables else {}
    return {key: value for key, value in table.items() if key not in tables} | own


Config = Annotated[
    Path | None,
    typer.Option(
        "--config", help="TOML with values for any of these options.", callback=_read_config, is_eager=True
    ),
]
