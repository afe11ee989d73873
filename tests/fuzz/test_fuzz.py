"""Every input whose end is known, and some drawn by a fixed number: `capture` keeps to the rule on all of them."""

from __future__ import annotations

from collections import Counter

import pytest

from fuzz.forked_run import CAN_RUN
from fuzz.kinds import KINDS
from fuzz.workers import rows

SECONDS = 40.0  # from the first input on, after which none is drawn; on a core of its own all are done then
MOST, BATCH = 9, 1  # inputs that are drawn, and of one kind before the next comes
FEWEST_SEEDS = 10  # of each kind


@pytest.mark.skipif(not CAN_RUN, reason="processes are copied, and what they take is limited, on Linux alone")
def test_capture_keeps_to_the_rule_on_every_input():
    told = list(rows(["--seconds", str(SECONDS), "--most", str(MOST), "--batch", str(BATCH)]))
    seeds = Counter(row["kind"] for row in told if row["seed"])
    assert set(seeds) == set(KINDS) and min(seeds.values()) >= FEWEST_SEEDS
    drawn = Counter(row["kind"] for row in told if not row["seed"])
    assert sum(drawn.values()) <= MOST
    assert {row["label"]: row["faults"] for row in told if row["faults"]} == {}
