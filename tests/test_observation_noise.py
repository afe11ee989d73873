"""Noise on what is measured: its range, and that it does not depend on how rounds and pairs are grouped."""

from __future__ import annotations

import numpy as np
import pytest

from capture_cli.context.observation_noise import NOISES, apply, check
from capture_cli.errors import OptionError

PAIRS, ROUNDS = 40, 31


def generators(count: int = PAIRS) -> list[np.random.Generator]:
    return [np.random.default_rng([7, pair]) for pair in range(count)]


@pytest.fixture
def labels() -> np.ndarray:
    return np.random.default_rng(0).integers(-1, 2, (PAIRS, ROUNDS, 1, 1)).astype(float)


def test_every_third_label_is_random(labels):
    noisy = apply("label", labels, generators())
    drawn = np.arange(ROUNDS) % 3 == 2
    np.testing.assert_array_equal(noisy[:, ~drawn], labels[:, ~drawn])
    values, counts = np.unique(noisy[:, drawn], return_counts=True)
    np.testing.assert_array_equal(values, [-1, 0, 1])
    assert (np.abs(counts / counts.sum() - 1 / 3) < 0.1).all()
    assert 0.5 < (noisy[:, drawn] != labels[:, drawn]).mean() < 0.8


def test_scale_is_between_nine_and_eleven_tenths():
    noisy = apply("scale", np.full((PAIRS, ROUNDS, 10, 2), -2.0), generators())
    assert -2.2 <= noisy.min() < -2.19
    assert -1.81 < noisy.max() <= -1.8
    assert abs(noisy.mean() + 2.0) < 0.01


@pytest.mark.parametrize("name", NOISES)
def test_grouping_does_not_matter(name, labels):
    whole = apply(name, labels, generators())
    one_by_one = generators()
    rounds = [apply(name, labels[:, [r]], one_by_one, first_round=r) for r in range(ROUNDS)]
    np.testing.assert_array_equal(whole, np.concatenate(rounds, axis=1))
    np.testing.assert_array_equal(whole[:5], apply(name, labels[:5], generators(5)))


def test_measured_is_not_overwritten(labels):
    before = labels.copy()
    for name in NOISES:
        assert apply(name, labels, generators()) is not labels
    np.testing.assert_array_equal(labels, before)


def test_noise_that_is_not_there_or_does_not_fit():
    with pytest.raises(OptionError, match="unknown noise 'lable'"):
        check("lable", ["label"])
    with pytest.raises(OptionError, match="puck_x, puck_y"):
        check("label", ["puck_x", "puck_y"])
    check("label", ["label"])
    check("scale", ["puck_x", "puck_y"])
