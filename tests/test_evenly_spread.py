"""Indices that are evenly spread: as many as asked for, from end to end."""

from __future__ import annotations

import numpy as np
import pytest

from capture_cli.common.evenly_spread import evenly_spread


@pytest.mark.parametrize("count", [1, 2, 15, 16, 17, 1000])
@pytest.mark.parametrize("most", [2, 3, 16, 64])
def test_so_many_from_the_first_to_the_last_with_gaps_alike(count, most):
    found = evenly_spread(count, most)
    assert len(found) == min(count, most)
    assert found[0] == 0 and found[-1] == count - 1
    assert np.ptp(np.diff(found)) <= 1 if len(found) > 1 else count == 1


def test_of_one_the_first():
    assert evenly_spread(5, 1).tolist() == [0]
