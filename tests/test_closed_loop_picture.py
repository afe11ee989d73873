"""The picture of the closed loop: units, and successes that are rare."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from docs.closed_loop_picture import Judged, _ratio, _with_interval

RUNS = Path(__file__).resolve().parents[1] / "runs"


@pytest.mark.parametrize(
    ("loop", "unit", "last"), [("closed-loop", "cm", 1.2), ("closed-loop-door", "rad", 0.05)]
)
def test_distances_are_in_a_unit_of_what_is_measured(loop, unit, last):
    of = Judged.read(RUNS / loop / "mended" / "evaluation")
    assert of.unit == unit and of.distance[:, -1].mean() == pytest.approx(last, rel=0.1)


def test_a_draw_without_a_success_before_is_no_number():
    """Infinitely better, or as good as before, where none succeeds after either."""
    chosen = np.array([[0, 1], [1, 1], [2, 2]])
    ratio = _ratio(np.array([1, 1, 0]), np.array([1, 0, 0]), chosen)
    assert ratio.tolist() == [2.0, 2.0, np.inf, 1.0]
    assert _with_interval(ratio) == "2 (95 %: 1 to inf)"
