"""Who finds the parameters. One identifier = one file; all are driven by ask / tell / best."""

from __future__ import annotations

from collections.abc import Callable

from capture_cli.common.registry import Registry
from capture_cli.errors import OptionError
from capture_cli.identifiers.base import AskTell, Identifier
from capture_cli.identifiers.refitted import refitted
from capture_cli.identifiers.rounds import RoundIdentifier

REGISTRY: Registry[AskTell] = Registry(
    "capture_cli.identifiers",
    "AskTell",
    "identifier",
    not_listed=("intervals", "refitted", "rounds", "undetermined"),
)


def log_identifier(name: str) -> type[Identifier]:
    """The identifier called `name`, which must be one that fits a whole log. Raises OptionError."""
    found = REGISTRY.get(name)
    if not issubclass(found, Identifier):
        raise OptionError(
            f"the identifier {name!r} works in rounds of actions",
            cure=f"choose {' or '.join(log_identifiers())}",
        )
    return found


def log_identifiers() -> list[str]:
    """Names of those that fit a whole log."""
    return [name for name, kind in REGISTRY.items() if issubclass(kind, Identifier)]


def round_identifier(
    name: str, offered: Callable[[type[AskTell]], bool] | None = None
) -> type[RoundIdentifier]:
    """The identifier called `name`, driven in rounds; one of whole logs refits after every round.

    Raises OptionError, naming those that are `offered`, or all.
    """
    found = REGISTRY.get(name, offered)
    return refitted(found) if issubclass(found, Identifier) else found
