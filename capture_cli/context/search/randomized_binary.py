"""Randomized binary search: each round is drawn from a symmetric Beta over the bracket (paper, Algorithm 1)."""

from scipy.special import betaincinv

from capture_cli.context.search._bracket import shrink
from capture_cli.context.search.base import Search


class RandomizedBinary(Search):
    summary = "a point of the shrinking bracket, drawn from Beta(alpha, alpha); the paper's"
    alpha = 5.0  # keeps samples off the bracket's ends

    def __init__(self, alpha: float = alpha):
        self.alpha = alpha

    def path(self, source, target, low, high, uniform):
        return shrink(source, target, low, high, betaincinv(self.alpha, self.alpha, uniform))
