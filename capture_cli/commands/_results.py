"""How results reach stdout: one JSON document, or tables."""

from __future__ import annotations

from typing import Any


def print_json(document: Any) -> None:
    from capture_cli.json_text import json_text

    print(json_text(document))


def console():
    from rich.console import Console

    return Console(highlight=False)
