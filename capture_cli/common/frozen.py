"""Settings of a module: one value, whose numbers have names, reasons and types, and do not change."""

from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")


def frozen(cls: type[T]) -> T:
    """The only instance of a class of settings, which becomes a frozen dataclass."""
    return dataclass(frozen=True)(cls)()
