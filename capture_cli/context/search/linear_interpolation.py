"""Linear interpolation: random points between source and target, in order (the paper's "linterp", Section IV-B)."""

import numpy as np

from capture_cli.context.search.base import Search


class LinearInterpolation(Search):
    summary = "random points on the line from source to target, in order; the paper's ablation"

    def path(self, source, target, low, high, uniform):
        part = np.sort(uniform[..., :1], axis=1)  # one draw a round: all parameters move along one line
        path = np.concatenate([source[:, None], source[:, None] + part * (target - source)[:, None]], axis=1)
        return np.clip(path, low, high)
