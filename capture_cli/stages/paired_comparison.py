"""Ours against every other identifier of an evaluation, pair by pair. Shared by stages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

OURS = "capture-refined"
AS_NEAR = 1e-3  # of the range: differences below this are none


def ours_among(identifiers: Sequence[Mapping[str, Any]]) -> str | None:
    """The label of OURS among {label, identifier, ...}: of several the one as in the paper, else the first."""
    labels = [about["label"] for about in identifiers if about["identifier"] == OURS]
    return OURS if OURS in labels else next(iter(labels), None)


def paired_comparison(
    labels: list[str], difference: np.ndarray, ours: str | None = OURS
) -> dict[str, dict[str, list[float]] | None]:
    """For each label: after every round, how often `ours` is nearer the truth than it; None where there is no such one.

    difference (identifier, seed, pair, entry, parameter): |estimate - truth| over the range, averaged here over
    parameters. nearer, as_near, further: pairs in which `ours` is; gained: the mean by which it is nearer, gained_se
    its standard error; p: of the sign test on nearer against further, two-sided.
    """
    if ours not in labels:
        return dict.fromkeys(labels)
    of_pairs = difference.mean(axis=-1).reshape(len(labels), -1, difference.shape[-2])
    own = of_pairs[labels.index(ours)]
    return {
        label: None if label == ours else _compared(other - own)
        for label, other in zip(labels, of_pairs, strict=True)
    }


def _compared(gained: np.ndarray) -> dict[str, list[float]]:
    """gained (pair, entry)."""
    from scipy.stats import binomtest

    nearer, further = (gained > AS_NEAR).sum(axis=0), (gained < -AS_NEAR).sum(axis=0)
    pairs = len(gained)
    se = gained.std(axis=0, ddof=1) / np.sqrt(pairs) if pairs > 1 else np.zeros(gained.shape[1])
    trials = zip(nearer.tolist(), further.tolist(), strict=True)
    return {
        "nearer": nearer.tolist(),
        "as_near": (pairs - nearer - further).tolist(),
        "further": further.tolist(),
        "gained": six_digits(gained.mean(axis=0)),
        "gained_se": six_digits(se),
        "p": [float(binomtest(a, a + b).pvalue) if a + b else 1.0 for a, b in trials],
    }


def six_digits(values: np.ndarray) -> list[float]:
    """What a document says of values (round,)."""
    return [float(f"{v:.6g}") for v in values]
