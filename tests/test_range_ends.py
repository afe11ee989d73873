"""Where the numbers of a sensor pile up: at the end of its range, and not where a motion turns round."""

from __future__ import annotations

import numpy as np
import pytest

from capture_cli.log.range_ends import largest_of, piled_up_from
from capture_cli.simulate.multisine import multisine

TIME = 0.004 * np.arange(3000)
MOVED = np.concatenate(
    [
        size * multisine(TIME[:600], 1, (0.3, 3.0), np.random.default_rng(0))[:, 0]
        for size in (1, 1.5, 2, 1.2, 0.9)
    ]
)


@pytest.mark.parametrize("noise", [0.0, 1e-3, 2e-2])
def test_numbers_pile_up_at_the_end_of_a_range_and_nowhere_else(noise):
    seen = MOVED + noise * np.random.default_rng(0).normal(size=len(TIME))
    assert piled_up_from(seen[:, None]) == np.inf
    assert 0.8 <= piled_up_from(np.clip(seen, -1.0, 1.0)[:, None]) < 1.0
    with_others = np.stack([np.clip(seen, -1.0, 1.0), 0.1 * seen], axis=1)
    assert 0.8 <= piled_up_from(with_others) < 1.0


def test_a_converter_cuts_off_at_one_number_whatever_else_is_near_it():
    """An accelerometer that mostly shows its own weight."""
    seen = 9.8 + 0.5 * MOVED + 0.1 * np.random.default_rng(0).normal(size=len(TIME))
    assert 9.0 < piled_up_from(np.minimum(seen, 10.3)[:, None]) < 10.3
    assert piled_up_from(seen[:, None]) == np.inf
    assert piled_up_from(0.1 * np.round(seen / 0.1)[:, None]) == np.inf  # nor do steps alone


def test_noise_alone_piles_up_nowhere():
    assert piled_up_from(np.random.default_rng(0).normal(size=(3000, 1))) == np.inf


def test_what_was_not_reported_and_spikes_do_not_count():
    seen = np.clip(MOVED, -1.0, 1.0)
    seen[5], seen[::3] = 50.0, np.nan
    assert largest_of(seen[:, None]) == pytest.approx(1.0)
    assert largest_of(np.full((4, 2), np.nan)) == 0
    assert piled_up_from(np.full((4, 2), np.nan)) == np.inf
    assert piled_up_from(np.zeros((400, 2))) == np.inf
