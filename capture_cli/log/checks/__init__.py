"""What is wrong, or worth knowing, with a measured log, before a model is blamed: findings, each with its cure.

In: a log, and where it is known the task that it belongs to. Out: findings (severity, where, message, cure), and the
log mended where that was asked for. What a log has to be for its task is one check in one file; the health of its
channels and times, whatever the task, is in `log_health` and `log_findings`.
"""

from capture_cli.common.registry import Registry, with_first
from capture_cli.log.checks.base import Check

REGISTRY: Registry[Check] = Registry(
    "capture_cli.log.checks",
    "Check",
    "check",
    not_listed=(
        "equal-episodes",
        "even-times",
        "held-outputs",
        "log-findings",
        "log-health",
        "parameter-bounds",
    ),
)
_FIRST = (  # are told in this order, before others
    "shared-columns",
    "units-in-names",
    "quaternion-order",
    "lengths",
    "ranges",
    "whole-turns",
    "degrees",
)


def in_order() -> list[type[Check]]:
    """Every check, in the order in which findings are told."""
    found = dict(REGISTRY.items())
    return [found[name] for name in with_first(found, _FIRST)]
