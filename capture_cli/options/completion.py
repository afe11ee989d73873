"""Values of options that the shell offers; where none fits, the shell offers names of files."""

import importlib
from collections.abc import Callable, Iterable
from pathlib import Path

Completion = Callable[[str], list[str]]


def words(*offered: str) -> Completion:
    """Completion of a few words."""
    return _beginning(lambda: offered)


def plug_ins(package: str) -> Completion:
    """Completion of the names in the registry of `package`, which is imported when a user asks for them."""
    return _beginning(lambda: importlib.import_module(package).REGISTRY.names())


def tasks(incomplete: str) -> list[str]:
    """Built-in tasks, and the TOML files of the folder."""
    files = sorted(p.name for p in Path().glob("*.toml") if p.name != "pyproject.toml")
    return [*plug_ins("capture_cli.model.tasks")(incomplete), *words(*files)(incomplete)]


def _beginning(offered: Callable[[], Iterable[str]]) -> Completion:
    """The completion that gives the words of `offered` that begin with the typed text."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in offered() if name.startswith(incomplete)]

    return complete


effects = plug_ins("capture_cli.model.effects")
identifiers = plug_ins("capture_cli.context.identifiers")
searches = plug_ins("capture_cli.context.search")
