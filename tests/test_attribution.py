"""Which of the accepted effects stay, where something is left."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from capture_cli.stages.attribution import Accepted, Attribution
from capture_cli.stages.candidates import Candidate


@dataclass
class Named:
    site: str


@dataclass
class FakeFit:
    names: tuple[str, ...]
    error: float


class FakeModels:
    def __init__(self, explained: bool):
        self.explained = explained

    def is_explained(self, fit: FakeFit) -> bool:
        return self.explained

    def without(self, fit: FakeFit, name: str) -> FakeFit:
        return FakeFit(tuple(n for n in fit.names if n != name), fit.error + 0.1)


@pytest.mark.parametrize(
    ("shares", "error", "explained", "kept"),
    [
        ([0.9, 0.01, 0.02], 1.0, True, 3),  # nothing is left: that is what they were
        ([0.9, 0.01, 0.02], 1.1, False, 1),  # minor ones that leave something explain nothing
        ([0.9, 0.03], 1.1, False, 2),  # one alone that comes near the floor
        ([0.9, 0.03], 1.5, False, 1),
        ([0.9, 0.03, 0.06], 1.5, False, 3),  # what was minor led to one that is not
        ([0.7, 0.2], 20.0, False, 2),
        ([], 20.0, False, 0),
    ],
)
def test_minor_effects_stand_only_where_they_explain(shares, error, explained, kept):
    names = tuple(f"effect{i}@joint" for i in range(len(shares)))
    placed = [(name.split("@")[0], Named("joint")) for name in names]
    attribution = Attribution.__new__(Attribution)
    attribution.models = FakeModels(explained)
    attribution.candidates = [Candidate(p) for p in placed]
    attribution.accepted = [Accepted(p, [], None, share) for p, share in zip(placed, shares, strict=True)]
    fit = attribution._without_minor(FakeFit(names, error))
    assert fit.names == tuple(a.name for a in attribution.accepted) == names[:kept]
    reasons = [c.why_rejected for c in attribution.candidates]
    assert reasons[:kept] == [None] * kept and all("correction" in r for r in reasons[kept:])
