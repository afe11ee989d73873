"""What a model may lack: one effect = one file. The file's stem is the effect's public name."""

from __future__ import annotations

from capture_cli.effects.base import Effect
from capture_cli.registry import Registry

REGISTRY: Registry[Effect] = Registry("capture_cli.effects", "Effect", "effect")
