"""Search strategies: how a history walks from source to target (paper, Algorithm 1)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import beta, kstest

from capture_cli.context.search import REGISTRY

PAIRS, ROUNDS = 10_000, 7
LOW, HIGH = np.array([0.03, -15.0, -1.0]), np.array([0.07, -3.0, 1.0])
BRACKETS = ["binary", "randomized-binary"]


def draws(seed: int = 0, pairs: int = PAIRS, rounds: int = ROUNDS):
    """source, target (pair, parameter) and uniform (pair, round - 1, parameter)."""
    generator = np.random.default_rng(seed)
    source, target = (generator.uniform(LOW, HIGH, (pairs, len(LOW))) for _ in range(2))
    return source, target, generator.random((pairs, rounds - 1, len(LOW)))


def walk(name: str, source, target, uniform, **options) -> np.ndarray:
    return REGISTRY.get(name)(**options).walk(source, target, LOW, HIGH, uniform)


def brackets(path: np.ndarray, target: np.ndarray):
    """What each round knows from the rounds before it: lower, upper (pair, round, parameter)."""
    below = np.where(path < target[:, None], path, LOW)
    above = np.where(path < target[:, None], HIGH, path)
    first = np.ones_like(target)[:, None]
    lower = np.concatenate([first * LOW, np.maximum.accumulate(below, axis=1)[:, :-1]], axis=1)
    upper = np.concatenate([first * HIGH, np.minimum.accumulate(above, axis=1)[:, :-1]], axis=1)
    return lower, upper


@pytest.mark.smoke
@pytest.mark.parametrize("name", REGISTRY.names())
def test_from_source_to_target_inside_the_bounds(name):
    source, target, uniform = draws()
    path = walk(name, source, target, uniform)
    assert path.shape == (PAIRS, ROUNDS, len(LOW))
    assert np.array_equal(path[:, 0], source)
    assert np.array_equal(path[:, -1], target)
    assert np.all((path >= LOW) & (path <= HIGH))


@pytest.mark.smoke
@pytest.mark.parametrize("name", REGISTRY.names())
def test_any_share_of_the_pairs_walks_the_same_way(name):
    source, target, uniform = draws()
    some = np.arange(17, PAIRS, 371)
    whole = walk(name, source, target, uniform)
    assert np.array_equal(walk(name, source[some], target[some], uniform[some]), whole[some])


@pytest.mark.parametrize("name", BRACKETS)
def test_each_round_lies_in_the_bracket_the_rounds_before_left(name):
    source, target, uniform = draws()
    path = walk(name, source, target, uniform)
    lower, upper = brackets(path, target)
    assert np.all((lower <= target[:, None]) & (target[:, None] <= upper))
    assert np.all((lower <= path) & (path <= upper))
    assert np.all(np.diff(upper - lower, axis=1) <= 0)


def test_binary_search_takes_the_middle_and_halves_the_bracket():
    source, target, uniform = draws()
    path = walk("binary", source, target, uniform)
    lower, upper = brackets(path, target)
    middle = (0.5 * (lower + upper))[:, 1:-1]
    np.testing.assert_allclose(path[:, 1:-1], middle, atol=1e-12)
    halvings = np.arange(1, ROUNDS - 1)[:, None]
    error = np.abs(path - target[:, None])[:, 1:-1]
    assert np.all(error <= (HIGH - LOW) / 2.0**halvings * (1 + 1e-9))


@pytest.mark.parametrize("alpha", [1.0, 5.0, 20.0])
def test_randomized_binary_search_draws_from_beta(alpha):
    source, target, uniform = draws(seed=1)
    path = walk("randomized-binary", source, target, uniform, alpha=alpha)
    lower, upper = brackets(path, target)
    part = ((path - lower) / (upper - lower))[:, 1:-1]
    for k in range(part.shape[1]):
        assert kstest(part[:, k].ravel(), beta(alpha, alpha).cdf).pvalue > 1e-4


def test_linear_interpolation_stays_on_the_line_and_never_turns_back():
    source, target, uniform = draws()
    path = walk("linear-interpolation", source, target, uniform)
    along = (path - source[:, None]) / (target - source)[:, None]
    np.testing.assert_allclose(along, np.repeat(along[..., :1], len(LOW), axis=2), atol=1e-6)
    assert np.all(np.diff(along[..., 0], axis=1) >= -1e-9)
    assert kstest(along[:, 1, 0], beta(1, ROUNDS - 1).cdf).pvalue > 1e-4  # the least of six uniform draws


@given(
    name=st.sampled_from(REGISTRY.names()),
    seed=st.integers(0, 2**32 - 1),
    rounds=st.integers(2, 13),
    alpha=st.floats(0.2, 50),
    at_bound=st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_invariants_hold_wherever_source_and_target_lie(name, seed, rounds, alpha, at_bound):
    source, target, uniform = draws(seed, pairs=50, rounds=rounds)
    if at_bound:
        target[:10], source[10:20], target[20:30] = LOW, HIGH, source[20:30]
    options = {} if REGISTRY.get(name).alpha is None else {"alpha": alpha}
    path = walk(name, source, target, uniform, **options)
    assert np.array_equal(path[:, -1], target)
    assert np.all((path >= LOW) & (path <= HIGH))
    if name in BRACKETS:
        lower, upper = brackets(path, target)
        assert np.all((lower <= path) & (path <= upper))


def test_scattered_rounds_are_near_and_far_and_half_of_them_stay():
    source, target, uniform = draws()
    path = walk("scattered", source, target, uniform)
    moved = (np.diff(path[:, :-1], axis=1) != 0).mean()
    assert 0.48 < moved < 0.52
    distance = np.abs(path[:, 2:-1] - target[:, None]) / (HIGH - LOW)
    shares = [(distance < bound).mean() for bound in (1e-3, 1e-2, 1e-1)]
    assert all(share > 0.05 for share in np.diff([0.0, *shares, 1.0])), shares
