"""Frozen classes of options: of each follow the arguments of its command line, its values, and its provenance."""

from __future__ import annotations

import copy
import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from typing import Annotated, Any, ClassVar, Self, TypeVar, get_type_hints

from typer.models import ArgumentInfo, OptionInfo

from capture_cli.options.config import Config

Result = TypeVar("Result")
# of any command, in this order behind its own
LAST = ("seed", "max_log_size", "threads", "force", "resume", "json_", "quiet", "config")
# they change no number of what is written
UNRECORDED = ("force", "resume", "json_", "quiet", "config", "fail_on")


@dataclass(frozen=True)
class Text:
    """What the command line has as texts of the type `kind`; read: of these, and the option's name, its value."""

    kind: Any
    read: Callable[[Any, str], Any]


@dataclass(frozen=True, kw_only=True)
class Options:
    """A field is on the command line if its type is annotated with a typer.Option or Argument; with a `Text`, too, if
    what is written there has to be read. An option without a name is called after its field.
    """

    config: Config = None
    unrecorded: ClassVar[tuple[str, ...]] = UNRECORDED  # fields that provenance leaves out

    @classmethod
    def parameters(cls) -> list[inspect.Parameter]:
        """The arguments of the command line, LAST at the end."""
        found = []
        for field in cls._ordered():
            option = field.option
            if option is None:
                continue
            text = _marker(field, Text)
            kind = field.kind.__origin__ if text is None else text.kind
            default = field.default if text is None else None
            if kind == list[str] and default is not inspect.Parameter.empty:
                default = []
            found.append(
                inspect.Parameter(
                    field.name,
                    inspect.Parameter.KEYWORD_ONLY,
                    default=default,
                    annotation=Annotated[kind, option],
                )
            )
        return found

    @classmethod
    def of_command_line(cls, given: Mapping[str, Any]) -> Self:
        """Raises OptionError for a text that cannot be read."""
        values = dict(given)
        for field in cls._ordered():
            if text := _marker(field, Text):
                values[field.name] = text.read(values[field.name], field.option.default)
        return cls(**values)

    def recorded(self) -> dict[str, Any]:
        """By name, what `provenance.json` says of them."""
        return {f.name: getattr(self, f.name) for f in self._ordered() if f.name not in self.unrecorded}

    @classmethod
    def default(cls, name: str) -> Any:
        """Of the option of that name."""
        return next(field.default for field in cls._ordered() if field.name == name)

    @classmethod
    @functools.cache
    def _ordered(cls) -> tuple[_Field, ...]:
        kinds = get_type_hints(cls, include_extras=True)
        found = sorted(fields(cls), key=lambda field: LAST.index(field.name) if field.name in LAST else -1)
        return tuple(_Field(field.name, kinds[field.name], _default(field)) for field in found)


@dataclass(frozen=True)
class _Field:
    name: str
    kind: Any
    default: Any

    @functools.cached_property
    def option(self) -> OptionInfo | ArgumentInfo | None:
        """On the command line; inside Annotated, typer takes the first name of an option for its default."""
        option = _marker(self, OptionInfo | ArgumentInfo)
        if not isinstance(option, OptionInfo) or option.default is not ...:
            return option
        named = copy.copy(option)
        named.default = f"--{self.name.replace('_', '-')}"
        return named


def _default(field: Any) -> Any:
    if field.default_factory is not MISSING:
        return field.default_factory()
    return inspect.Parameter.empty if field.default is MISSING else field.default


def _marker(field: _Field, kind: Any) -> Any:
    """The annotation of this kind, None where there is none."""
    return next((m for m in getattr(field.kind, "__metadata__", ()) if isinstance(m, kind)), None)


def on_command_line(command: Callable[[Any], None]) -> Callable[..., None]:
    """The function that typer takes, of a command that takes its options as one value."""
    kind = get_type_hints(command)["options"]

    def called(**given: Any) -> None:
        command(kind.of_command_line(given))

    parameters = kind.parameters()
    called.__name__, called.__doc__ = command.__name__, command.__doc__
    called.__signature__ = inspect.Signature(parameters)
    called.__annotations__ = {p.name: p.annotation for p in parameters}
    return called


def takes_options(stage: Callable[[Any], Result]) -> Callable[..., Result]:
    """A stage that takes its options as one value, or the fields of it as keywords."""
    kind = get_type_hints(stage)["options"]

    @functools.wraps(stage)
    def called(options: Any = None, /, **given: Any) -> Result:
        return stage(kind(**given) if options is None else options)

    return called
