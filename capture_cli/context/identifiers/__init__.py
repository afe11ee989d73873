"""Who finds parameters round by round: the transformer and its rivals. One identifier = one file; ask / tell / best."""

from collections.abc import Callable

from capture_cli.common.registry import Registry
from capture_cli.context.identifiers.base import RoundIdentifier
from capture_cli.context.identifiers.refitted import refitted
from capture_cli.errors import OptionError
from capture_cli.estimate import solve
from capture_cli.estimate.solve.base import AskTell, Identifier

REGISTRY: Registry[AskTell] = Registry(
    "capture_cli.context.identifiers",
    "AskTell",
    "identifier",
    not_listed=("refitted",),
    besides=solve.REGISTRY,
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
