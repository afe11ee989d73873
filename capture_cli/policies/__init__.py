"""Who chooses the action of an episode. One kind of policy = one file."""

from __future__ import annotations

from capture_cli.policies.base import Policy
from capture_cli.registry import Registry

REGISTRY: Registry[Policy] = Registry("capture_cli.policies", "Policy", "policy")
