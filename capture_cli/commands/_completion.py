"""What the shell offers for the values of options; where none of it fits, the shell goes on with names of files."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

Completion = Callable[[str], list[str]]


def words(*offered: str) -> Completion:
    """Those of a few words that begin as what was typed."""
    return _beginning(lambda: offered)


def tasks(incomplete: str) -> list[str]:
    """Built-in tasks, and the TOML files of the folder."""
    from capture_cli.tasks import REGISTRY

    files = sorted(p.name for p in Path().glob("*.toml") if p.name != "pyproject.toml")
    return _beginning(lambda: [*REGISTRY.names(), *files])(incomplete)


def effects(incomplete: str) -> list[str]:
    """Names of the catalogue."""
    from capture_cli.effects import REGISTRY

    return _beginning(REGISTRY.names)(incomplete)


def identifiers(incomplete: str) -> list[str]:
    """Identifiers that may be evaluated, trained or not."""
    from capture_cli.identifiers import REGISTRY

    return _beginning(REGISTRY.names)(incomplete)


def searches(incomplete: str) -> list[str]:
    """Search strategies of histories."""
    from capture_cli.search import REGISTRY

    return _beginning(REGISTRY.names)(incomplete)


def _beginning(offered: Callable[[], Iterable[str]]) -> Completion:
    """The completion that gives what of `offered` begins as what was typed."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in offered() if name.startswith(incomplete)]

    return complete
