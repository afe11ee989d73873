"""Who finds the parameters. One identifier = one file; all are driven by the same ask / tell / best."""

from __future__ import annotations

from capture_cli.identifiers.base import Identifier
from capture_cli.registry import Registry

REGISTRY: Registry[Identifier] = Registry(
    "capture_cli.identifiers", "Identifier", "identifier", not_listed=("intervals")
)
