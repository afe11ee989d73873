"""Frozen classes of options: of each follow the arguments of its command line, its values, and its provenance."""

from __future__ import annotations

import copy
import functools
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields
from typing import Annotated, Any, ClassVar, Self, TypeVar, get_type_hints

import typer
from typer.models import ArgumentInfo, OptionInfo

from capture_cli.common.documents import SETTINGS as DOCUMENTS
from capture_cli.errors import OptionError, did_you_mean
from capture_cli.options.completion import Completion, words
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


def described(
    help: str,
    *,
    name: str | None = None,
    offers: Completion | Sequence[str] = (),
    one_of: Sequence[str] = (),
    within: tuple[float, float] | None = None,
    **more: Any,
) -> OptionInfo:
    """What typer has of an option. name: where it is not called after its field. offers: what the shell does, or these
    words. one_of: all words that it may be. within: what a number is between, and neither of them; ends that it may be
    are `min` and `max`. more: as typer.Option takes it.
    """
    offers = one_of or offers
    completion = offers if callable(offers) or not offers else words(*offers)
    info = typer.Option(name or ..., help=help, autocompletion=completion or None, **more)
    info.one_of, info.within = one_of, within
    return info


def option(default: Any, help: str, *, text: Text | None = None, **more: Any) -> Any:
    """A field of options that the command line has; it has to be given there where `default` is `...`.

    text: where what is written has to be read. more: as `described` takes it.
    """
    given = {"default_factory": dict} if default == {} else {} if default is ... else {"default": default}
    return field(metadata={"option": described(help, **more), "text": text}, **given)


@dataclass(frozen=True, kw_only=True)
class Options:
    """A field is on the command line if it is an `option`, or its type is annotated with a typer.Option or Argument, as
    those of `shared` are. An option without a name is called after its field.
    """

    config: Config = None
    unrecorded: ClassVar[tuple[str, ...]] = UNRECORDED  # fields that provenance leaves out

    def __post_init__(self) -> None:
        """Raises OptionError for a word or a number that an option does not take."""
        for own in self._ordered():
            own.check(getattr(self, own.name))

    @classmethod
    def parameters(cls) -> list[inspect.Parameter]:
        """The arguments of the command line, LAST at the end."""
        kind = inspect.Parameter.KEYWORD_ONLY
        return [
            inspect.Parameter(own.name, kind, default=own.written, annotation=Annotated[own.kind, own.info])
            for own in cls._ordered()
            if own.info is not None
        ]

    @classmethod
    def of_command_line(cls, given: Mapping[str, Any]) -> Self:
        """Raises OptionError for a text that cannot be read."""
        read = {
            own.name: own.text.read(given[own.name], own.info.default)
            for own in cls._ordered()
            if own.text is not None
        }
        return cls(**{**given, **read})

    def recorded(self) -> dict[str, Any]:
        """By name, what `provenance.json` says of them."""
        return {
            own.name: getattr(self, own.name) for own in self._ordered() if own.name not in self.unrecorded
        }

    @classmethod
    def default(cls, name: str) -> Any:
        """Of the option of that name."""
        return next(own.default for own in cls._ordered() if own.name == name)

    @classmethod
    @functools.cache
    def _ordered(cls) -> tuple[_Field, ...]:
        kinds = get_type_hints(cls, include_extras=True)
        found = sorted(fields(cls), key=lambda own: LAST.index(own.name) if own.name in LAST else -1)
        return tuple(_Field.of(own, kinds[own.name]) for own in found)


@dataclass(frozen=True)
class _Field:
    """kind: its type on the command line. info: what typer has of it; None where it is not there."""

    name: str
    kind: Any
    default: Any
    info: OptionInfo | ArgumentInfo | None
    text: Text | None

    @classmethod
    def of(cls, own: Field, hint: Any) -> _Field:
        """hint: its type."""
        annotated = getattr(hint, "__metadata__", ())
        text, info = own.metadata.get("text"), own.metadata.get("option", next(iter(annotated), None))
        kind = text.kind if text else hint.__origin__ if annotated else hint
        if isinstance(info, OptionInfo) and info.default is ...:
            # inside Annotated, typer takes the first name of an option for its default
            info = copy.copy(info)
            info.default = f"--{own.name.replace('_', '-')}"
        default = own.default_factory() if own.default_factory is not MISSING else own.default
        return cls(own.name, kind, inspect.Parameter.empty if default is MISSING else default, info, text)

    @property
    def written(self) -> Any:
        """The default on the command line."""
        if self.default is inspect.Parameter.empty:
            return self.default
        return [] if self.kind == list[str] else None if self.text else self.default

    def check(self, value: Any) -> None:
        """Raise OptionError where the option does not take the value, or no work ends with such a number."""
        offered = getattr(self.info, "one_of", ())
        if offered and value is not None and value not in offered:
            raise OptionError(f"unknown {self.info.default} {value!r}", cure=did_you_mean(value, offered))
        for number in value if isinstance(value, list | tuple) else (value,):
            if self.info is not None and isinstance(number, int | float):
                self._check_number(number)

    def _check_number(self, number: float) -> None:
        low, high, within = self.info.min, self.info.max, getattr(self.info, "within", None)
        above, below = within or (-math.inf, math.inf)
        is_whole, largest_whole = isinstance(number, int), 2**31 - 1  # of what is counted
        if is_whole and number > largest_whole and self.name not in ("seed", "max_log_size"):
            taken = f"whole number of {largest_whole} at most"
        elif not (is_whole or abs(number) <= DOCUMENTS.largest):
            taken = f"finite number, of {DOCUMENTS.largest:g} at most"
        elif above < number < below and (low is None or low <= number) and (high is None or number <= high):
            return
        else:
            ends = "" if within is None or below == math.inf else f" between {above:g} and {below:g}"
            kind = "positive" if within == (0, math.inf) else "whole" if is_whole else ""
            taken = f"{kind} number{range_of(low, high)}{ends}".strip()
        found = short(str(number)) if is_whole else f"{number:g}"
        raise OptionError(f"{self.info.default} {found}", cure=f"give a {taken}")


def short(text: str) -> str:
    """What was found, not longer than a line."""
    shown = 60  # characters
    return text if len(text) <= shown else f"{text[:shown]}... ({len(text)} characters)"


def range_of(low: float | None, high: float | None) -> str:
    """What numbers an option takes, in words, to go on with after "a number"."""
    if low is None and high is None:
        return ""
    if high is None:
        return f" of {low} or more"
    return f" of {high} at most" if low is None else f" from {low} to {high}"


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
