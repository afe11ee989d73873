"""Intervals where contacts make the error rough: what sampling says, where a curvature is far from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, truncnorm

from capture_cli.estimate.solve._sampled_posterior import SETTINGS as SAMPLED_POSTERIOR
from capture_cli.estimate.solve._sampled_posterior import is_rough, sampled_posterior
from capture_cli.estimate.solve.intervals import intervals, unit_covariance
from capture_cli.estimate.solve.linearization import Data, Linearization, Trial, columns
from capture_cli.model.parameters import Parameter, ParameterSpace

STEPS = 400
NOISE = 0.01
LOGS = 40


def linearized(simulate, at: float, truth: float, starts: int = 0, seed: int = 3):
    """A log of one window that `simulate` makes of the parameter `truth`, linearized where it is `at`."""
    space = ParameterSpace([Parameter("com", "m", 0.0, 1.0, 0.5)])
    noise = NOISE * np.random.default_rng(seed).standard_normal(STEPS)
    measured = (simulate(truth) + noise)[None, :, None]
    mask = np.ones_like(measured, dtype=bool)
    data = Data(space, measured, mask, np.array([NOISE]), np.ones((1, starts)))

    def evaluate(trial: Trial):
        outputs = np.stack([simulate(p[0]) for p in trial.parameters])[:, None, :, None]
        return outputs, np.zeros((len(trial), 1), dtype=bool)

    x, corrections = np.array([at]), np.zeros((1, starts))
    return Linearization.from_columns(
        data, x, corrections, *evaluate(columns(data, x, corrections))
    ), evaluate


def ramp(com: float) -> np.ndarray:
    return com * np.linspace(0, 1, STEPS)


def rod(com: float) -> np.ndarray:
    """It hardly leans with the centre of mass left of 0.6, a little jaggedly, and tips where it is to the right."""
    leans = 0.02 * (com - 0.5) + 2e-4 * np.sin(3e4 * com) + 30 * max(com - 0.6, 0.0)
    return leans * np.linspace(0, 1, STEPS)


def test_an_error_that_is_a_parabola_is_left_to_its_curvature():
    at, evaluate = linearized(ramp, at=0.5, truth=0.5)
    assert not is_rough(at, unit_covariance(at)[0], evaluate)


@pytest.mark.parametrize("ratio", [0.05, 20.0])
def test_two_parameters_that_are_nearly_one_are_compared_along_their_ridge(ratio):
    """Outputs that are straight for some sd and bend far from the ridge, where a parameter moved by as much as belongs
    to the other, `ratio` times as well known, would be.
    """
    time = np.linspace(0, 1, STEPS)
    shapes = np.stack([time, ratio * (time + 0.1 * time**2)])
    space = ParameterSpace([Parameter(name, "1", 0.0, 1.0, 0.5, step=1e-6) for name in ("drag", "mass")])
    sd = NOISE * min(1.0, ratio)  # so that both are known to some hundredths of their ranges
    noise = sd * np.random.default_rng(3).standard_normal(STEPS)
    noise -= shapes.T @ np.linalg.lstsq(shapes.T, noise, rcond=None)[0]  # the estimate is the best
    measured = noise[None, :, None]
    data = Data(space, measured, measured != 0, np.array([sd]), np.ones((1, 0)))
    asked = []

    def evaluate(trial: Trial):
        asked.append(trial.parameters - 0.5)
        straight = asked[-1] @ shapes
        outputs = straight + straight**3 / sd**2
        return outputs[:, None, :, None], np.zeros((len(trial), 1), dtype=bool)

    x, corrections = np.full(2, 0.5), np.zeros((1, 0))
    at = Linearization.from_columns(data, x, corrections, *evaluate(columns(data, x, corrections)))
    covariance, _ = unit_covariance(at)
    assert abs(covariance[0, 1]) > 0.99 * np.sqrt(np.diag(covariance).prod())
    assert not is_rough(at, covariance, evaluate)
    distance = np.einsum("np,pq,nq->n", asked[-1], np.linalg.inv(covariance), asked[-1])
    assert np.sqrt(distance) == pytest.approx(np.full(4, SAMPLED_POSTERIOR.away))


def test_where_starts_are_fitted_the_curvature_is_all_there_is():
    at, evaluate = linearized(rod, at=0.5999, truth=0.57, starts=3)
    covariance, _ = unit_covariance(at)
    assert is_rough(at, covariance, evaluate)
    ways = np.random.default_rng(0).standard_normal(at.by_initial.shape)
    assert not is_rough(replace(at, by_initial=ways), covariance, evaluate)


@pytest.mark.parametrize("at", [0.58, 0.5999])
def test_a_rod_that_may_tip(at):
    """Differences over a step to the right see it tip, or a bump: what a curvature says is far too sure."""
    hit = 0
    for seed in range(LOGS):
        found, evaluate = linearized(rod, at, truth=0.57, seed=seed)
        covariance, _ = unit_covariance(found)
        assert is_rough(found, covariance, evaluate)
        sampled = sampled_posterior(found, covariance, evaluate, seed=0)
        sure = intervals(found, sampled=sampled)
        assert sure.low[0] <= at <= sure.high[0] < 0.65, "where it would have tipped it is not"
        hit += sure.low[0] <= 0.57 <= sure.high[0]
    assert hit >= binom.ppf(0.001, LOGS, 0.95)


def test_sampling_agrees_with_a_parabola():
    at, evaluate = linearized(ramp, at=0.5, truth=0.5)
    covariance, _ = unit_covariance(at)
    hessian, gradient = at.normal(1.0)
    best = 0.5 + float(gradient[0] / hessian[0, 0])
    sampled = sampled_posterior(at, covariance, evaluate, seed=0)
    assert np.sqrt(sampled.covariance[0, 0]) == pytest.approx(np.sqrt(covariance[0, 0]), rel=0.25)
    assert sampled.mean[0] == pytest.approx(best, abs=0.3 * np.sqrt(covariance[0, 0]))


def test_the_same_seed_says_the_same():
    found, evaluate = linearized(rod, 0.58, 0.57)
    covariance, _ = unit_covariance(found)
    one, two = (sampled_posterior(found, covariance, evaluate, seed=1) for _ in range(2))
    np.testing.assert_array_equal(one.covariance, two.covariance)
    np.testing.assert_array_equal(one.point, two.point)


@pytest.mark.parametrize("off", [-1.0, 0.0, 0.5, 50.0])
def test_at_a_bound_the_posterior_is_cut_and_not_heaped_up(off):
    """Nothing of it is below 0: what was drawn there had been moved to the bound, and halved the mean."""
    sd = NOISE / np.sqrt(STEPS / 3)
    centre = off * sd
    truth = truncnorm((0 - centre) / sd, (1 - centre) / sd, centre, sd)

    def shifted(com: float) -> np.ndarray:
        return (com - centre) * np.linspace(0, 1, STEPS)

    means = []
    for seed in range(LOGS):
        space = ParameterSpace([Parameter("com", "m", 0.0, 1.0, 0.5)])
        data = Data(
            space,
            np.zeros((1, STEPS, 1)),
            np.ones((1, STEPS, 1), dtype=bool),
            np.array([NOISE]),
            np.ones((1, 0)),
        )

        def evaluate(trial: Trial):
            outputs = np.stack([shifted(p[0]) for p in trial.parameters])[:, None, :, None]
            return outputs, np.zeros((len(trial), 1), dtype=bool)

        x, corrections = np.array([max(centre, 0.0)]), np.zeros((1, 0))
        at = Linearization.from_columns(data, x, corrections, *evaluate(columns(data, x, corrections)))
        means.append(sampled_posterior(at, np.array([[sd**2]]), evaluate, seed).mean[0])
    assert np.mean(means) == pytest.approx(truth.mean(), abs=0.1 * truth.std())
