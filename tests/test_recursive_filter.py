"""A filter with a memory does what scipy.signal.lfilter does."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from capture_cli.common.recursive_filter import recursion, recursively_filtered

FACTORS = st.lists(st.floats(-0.45, 0.45), min_size=1, max_size=2)  # such that nothing grows


@settings(deadline=None, max_examples=50)
@given(
    zeros=FACTORS,
    poles=FACTORS,
    steps=st.integers(3, 200),
    columns=st.integers(1, 3),
    seed=st.integers(0, 99),
)
def test_along_each_column_it_is_the_filter_of_scipy(zeros, poles, steps, columns, seed):
    signal = np.random.default_rng(seed).standard_normal((steps, columns))
    expected = lfilter(zeros, [1.0, *poles], signal, axis=0)
    assert recursively_filtered(zeros, poles, signal) == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert recursively_filtered(zeros, poles, signal[:, 0]) == pytest.approx(
        expected[:, 0], rel=1e-12, abs=1e-12
    )


def test_a_recursion_of_all_steps_at_once_is_that_step_by_step():
    generator = np.random.default_rng(0)
    for steps in (1, 2, 50):
        transition, driven = (
            0.5 * generator.standard_normal((2, 2, 3)),
            generator.standard_normal((steps, 2, 3)),
        )
        x, would = np.zeros((2, 3)), []
        for now in driven:
            would.append(x)
            x = np.einsum("ijr,jr->ir", transition, x) + now
        np.testing.assert_allclose(recursion(transition, driven), would, rtol=1e-12, atol=1e-12)
