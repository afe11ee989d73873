"""How results reach stdout: one JSON document, or tables."""

from collections.abc import Collection
from typing import Any

import typer


def print_json(document: Any) -> None:
    from capture_cli.common.json_text import json_text

    print(json_text(document))


def console():
    """The terminal. No text is markup: a name or a unit comes from a file, and may hold what looks like it."""
    from rich.console import Console

    return Console(highlight=False, markup=False, emoji=False)


def fail_on(found: Collection[str], named: Collection[str]) -> None:
    """End with 3 where what was `found` has something that --fail-on named."""
    if set(found) & set(named):
        raise typer.Exit(3)
