"""Binary search: each round is the middle of the bracket (the paper's ablation "binary", Section IV-B)."""

import numpy as np

from capture_cli.context.search._bracket import shrink
from capture_cli.context.search.base import Search


class Binary(Search):
    summary = "the middle of the shrinking bracket; the paper's ablation"

    def path(self, source, target, low, high, uniform):
        return shrink(source, target, low, high, np.full_like(uniform, 0.5))
