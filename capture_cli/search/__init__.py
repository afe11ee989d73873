"""How a history walks from its source to its target. One strategy = one file."""

from __future__ import annotations

from capture_cli.registry import Registry
from capture_cli.search.base import Search

REGISTRY: Registry[Search] = Registry("capture_cli.search", "Search", "search strategy")
