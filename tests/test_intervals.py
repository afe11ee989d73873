"""Intervals: how wide they are where noise and sensitivities are not alike in all outputs."""

from __future__ import annotations

import numpy as np
import pytest

from capture_cli.estimate.solve.intervals import Intervals, unit_covariance
from capture_cli.estimate.solve.linearization import Data, Linearization
from capture_cli.model.parameters import Parameter, ParameterSpace


@pytest.mark.parametrize("level", [False, True], ids=["tumbling", "level"])
def test_noise_of_an_attitude_is_about_three_axes(level):
    """Four numbers of unit length have noise across them alone, and that is where parameters move them."""
    windows, steps, noise = 20, 200, 1e-2
    generator = np.random.default_rng(0)
    attitude = generator.standard_normal((windows, steps, 4))
    if level:
        attitude[:] = 1.0, 0.0, 0.0, 0.0
    attitude /= np.linalg.norm(attitude, axis=2, keepdims=True)

    def across(vectors: np.ndarray) -> np.ndarray:
        return vectors - (vectors * attitude).sum(axis=2, keepdims=True) * attitude

    error, slope = (across(generator.standard_normal(attitude.shape)) for _ in range(2))
    error *= noise
    floor = np.sqrt(np.square(error).mean())
    data = Data(
        ParameterSpace([Parameter("inertia", "kg m^2", 0.0, 1.0, 0.5)]),
        np.zeros(attitude.shape),
        np.ones(attitude.shape, dtype=bool),
        np.full(4, floor),
        np.zeros((windows, 0)),
        attitudes=[np.arange(4)],
    )
    residual, by_parameter = (values.reshape(windows, -1) / floor for values in (error, slope))
    nothing = np.zeros((windows, steps * 4, 0))
    at = Linearization(
        data, np.array([0.5]), np.zeros((windows, 0)), residual, by_parameter[..., None], nothing
    )
    covariance, _ = unit_covariance(at)
    assert covariance[0, 0] == pytest.approx(noise**2 / np.square(slope).sum(), rel=0.05)


@pytest.mark.parametrize(
    ("value", "sd", "at_bound"),
    [
        (0.2, 4e-4, True),
        (0.2005, 4e-4, True),
        (0.799, 4e-4, False),  # 1e-4 of the range is 1 kg
        (0.799, 0.4, True),
        (2.0, 0.4, False),
        (10000.0, 0.0, True),
    ],
)
def test_what_is_at_a_bound_is_judged_by_its_sd_too(value, sd, at_bound):
    space = ParameterSpace([Parameter("mass", "kg", 0.2, 10000.0, 0.5)])
    one = np.array([value])
    found = Intervals(np.array([[sd**2]]), np.array([sd]), one, one, np.array([True]), 10.0)
    assert found.rows(space, one, [0])[0]["at_bound"] is at_bound
