"""Regression over a cloud of simulated points: what it makes of noise, and of outputs that are not linear."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom

from capture_cli.context.identifiers._cloud import Cloud, _law, improve

FEATURES, VALUES = 2, 40  # values of a round, of both features in turn


def linear(generator):
    """Slopes (round, d, p) of three rounds, and the outputs (round, d) at 0."""
    return generator.standard_normal((3, VALUES, 2)), generator.standard_normal((3, VALUES))


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), a=st.sampled_from([0.0, 0.03]), b=st.sampled_from([0.0, 0.1]))
def test_the_law_of_the_noise_is_found(seed, a, b):
    generator = np.random.default_rng(seed)
    outputs = generator.standard_normal(2000)
    truth = a**2 + b**2 * outputs**2
    squares = truth * generator.standard_normal(2000) ** 2 + 1e-8
    found = _law(squares, outputs**2, np.zeros(2000))
    off = np.abs(np.log((found + 2e-6) / (truth + 2e-6)))
    assert np.median(off) < 0.2
    assert off.mean() < 0.3


def test_linear_outputs_are_a_weighted_regression():
    generator = np.random.default_rng(0)
    truth, sd = np.array([0.42, 0.55]), 0.05
    slopes, offset = linear(generator)
    measured = offset + slopes @ truth + sd * generator.standard_normal(offset.shape)
    cloud = Cloud.about(np.full(2, 0.5), 0.05**2 * np.eye(2), VALUES)
    improve({0: cloud}, {0: measured}, lambda wanted: [offset + slopes @ x for _, _, x in wanted], FEATURES)
    j = slopes.reshape(-1, 2)
    expected = np.linalg.lstsq(j, (measured - offset).ravel(), rcond=None)[0]
    np.testing.assert_allclose(cloud.mean, expected, atol=0.002)
    np.testing.assert_allclose(cloud.covariance, sd**2 * np.linalg.inv(j.T @ j), rtol=0.5, atol=5e-6)


@pytest.mark.parametrize("bend", [0.0, 3.0])
def test_a_bend_is_no_evidence(bend):
    held = 0
    for seed in range(40):
        generator = np.random.default_rng(seed)
        truth = 0.3 + 0.4 * generator.random(2)
        slopes, offset = linear(generator)

        def outputs(wanted, slopes=slopes, offset=offset):
            return [(offset + slopes @ x + bend * (slopes @ (x - 0.5)) ** 2)[rows] for _, rows, x in wanted]

        measured = outputs([(0, [0, 1, 2], truth)])[0]
        measured = measured * generator.uniform(0.9, 1.1, measured.shape)
        cloud = Cloud.about(np.full(2, 0.5), 0.1**2 * np.eye(2), VALUES)
        for rounds in (1, 2, 3):
            improve({0: cloud}, {0: measured[:rounds]}, outputs, FEATURES)
        held += (np.abs(cloud.mean - truth) < 1.96 * np.sqrt(np.diag(cloud.covariance))).sum()
    assert binom.cdf(held, 80, 0.95) > 1e-3
