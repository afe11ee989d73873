"""Who finds the parameters. One identifier = one file; all are driven by ask / tell / best."""

from __future__ import annotations

from capture_cli.errors import OptionError
from capture_cli.identifiers.base import AskTell, Identifier
from capture_cli.identifiers.rounds import RoundIdentifier
from capture_cli.registry import Registry

REGISTRY: Registry[AskTell] = Registry(
    "capture_cli.identifiers", "AskTell", "identifier", not_listed=("intervals", "refitted", "rounds")
)


def log_identifier(name: str) -> type[Identifier]:
    """The identifier called `name` that fits a whole log. Raises OptionError."""
    return _of_kind(name, Identifier, "fits a whole log")


def round_identifier(name: str) -> type[RoundIdentifier]:
    """The identifier called `name` that proposes parameters round by round. Raises OptionError."""
    return _of_kind(name, RoundIdentifier, "works in rounds")


def _of_kind(name: str, kind: type, what: str):
    found = REGISTRY.get(name)
    if not issubclass(found, kind):
        names = [n for n, c in REGISTRY.items() if issubclass(c, kind)]
        raise OptionError(
            f"the identifier {name!r} is not one that {what}", cure=f"choose {', '.join(names)}"
        )
    return found
