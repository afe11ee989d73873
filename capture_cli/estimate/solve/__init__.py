"""Parameters from windows of a log: the simulator linearized, and searches that fit it. One search = one file.

In: `Data`, what was measured with its noise (`linearization`), and where to begin. Out: the point that explains it
best, how well it is determined (`intervals`), and what is left open (`undetermined`). All are driven by ask and tell.
"""

from capture_cli.common.registry import Registry
from capture_cli.estimate.solve.base import Identifier

REGISTRY: Registry[Identifier] = Registry(
    "capture_cli.estimate.solve",
    "Identifier",
    "identifier",
    not_listed=("intervals", "linearization", "undetermined"),
)
