"""Who chooses the action of an episode. One kind of policy = one file."""

from capture_cli.common.registry import Registry
from capture_cli.context.policies.base import Policy

REGISTRY: Registry[Policy] = Registry("capture_cli.context.policies", "Policy", "policy")
