"""How results reach stdout: one JSON document, or tables."""

from __future__ import annotations

from typing import Any


def print_json(document: Any) -> None:
    import json

    print(json.dumps(document, indent=2, allow_nan=False))


def console():
    from rich.console import Console

    return Console(highlight=False)
