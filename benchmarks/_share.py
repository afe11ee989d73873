"""A share of trials, with its interval."""

from __future__ import annotations

from typing import Any


def share(hits: int, trials: int) -> dict[str, Any] | None:
    """A binomial share with its exact 95 % interval (Clopper and Pearson 1934); None without trials."""
    from scipy.stats import binomtest

    if not trials:
        return None
    low, high = binomtest(hits, trials).proportion_ci(0.95, method="exact")
    return {"hits": hits, "of": trials, "share": hits / trials, "low": float(low), "high": float(high)}
