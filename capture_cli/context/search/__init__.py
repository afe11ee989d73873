"""How a history walks from its source to its target. One strategy = one file."""

from capture_cli.common.registry import Registry
from capture_cli.context.search.base import Search

REGISTRY: Registry[Search] = Registry("capture_cli.context.search", "Search", "search strategy")
