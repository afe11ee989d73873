"""How results reach stdout: one JSON document, or tables."""

from __future__ import annotations

from typing import Any


def print_json(document: Any) -> None:
    from capture_cli.common.json_text import json_text

    print(json_text(document))


def console():
    """The terminal. No text is markup: a name or a unit comes from a file, and may hold what looks like it."""
    from rich.console import Console

    return Console(highlight=False, markup=False, emoji=False)
