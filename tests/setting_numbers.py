"""Other numbers in the settings of a module, for a test."""

from __future__ import annotations

import importlib
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest


def set_numbers(
    patch: pytest.MonkeyPatch, module: ModuleType | str, settings: str = "SETTINGS", **numbers: Any
) -> None:
    """From here on, `settings` of the module, or of the one called so, has these numbers."""
    module = importlib.import_module(module) if isinstance(module, str) else module
    patch.setattr(module, settings, replace(getattr(module, settings), **numbers))
