"""A small part of the planted-effect benchmark, and how it judges and keeps what it finds."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks._planted import pages, results
from benchmarks._planted.cases import LEFT, MAGNITUDES, NOTHING, PLANTED, UNKNOWN, Case, cases, direction, size
from benchmarks._planted.diagnosing import line
from benchmarks._planted.outcomes import judge
from benchmarks._planted.outside import OUTSIDE
from benchmarks._planted.summary import confusion, share, summary
from benchmarks.base import Figure  # noqa: F401 (figures are compared by their attributes)
from capture_cli.effects import REGISTRY
from capture_cli.tasks import load_task
from benchmarks import MACHINES

EPISODES = 8  # instead of twelve: a third of the time
# Sizes as the search of the benchmark finds them for an error of ten times the noise, rounded.
OBVIOUS = (
    Case(PLANTED, "slider", "coulomb-friction", "x", 10.0, 0),
    Case(PLANTED, "slider", "cubic-stiffness", "x", 10.0, 0),
    Case(PLANTED, "slider", "sensor-low-pass", "q", 10.0, 0),
)
SIZE = 0.1


@pytest.mark.parametrize("case", OBVIOUS, ids=lambda c: c.effect)
def test_an_obvious_effect_is_found(case):
    row = line(case, SIZE, EPISODES)
    assert row["before"]["test"] > 3
    assert row["outcome"] == "exact", row["found"]
    assert row["after"]["test"] < 1.2


@pytest.mark.parametrize("machine", ["slider", "cart_pole"])
def test_nothing_is_found_where_nothing_is_missing(machine):
    row = line(Case(NOTHING, machine, "", "", 1.0, 0), episodes=EPISODES)
    assert row["outcome"] == "silent", row["found"]
