"""CMA-ES on machines whose initial states are not known."""

from __future__ import annotations

import numpy as np
import pytest

from capture_cli.estimate.solve.cma_es import CmaEs
from capture_cli.estimate.solve.linearization import Data
from capture_cli.model.parameters import Parameter, ParameterSpace

WINDOWS, STEPS = 6, 60
NOISE, START_SD = 1e-2, 0.3
TIMES = np.linspace(0, 3, STEPS)
SPACE = ParameterSpace([Parameter("pull", "1", -1.0, 1.0, 0.8), Parameter("curve", "1", -1.0, 1.0, 0.8)])
TRUTH = np.array([0.1, -0.2])


def outputs(parameters: np.ndarray, corrections: np.ndarray) -> np.ndarray:
    """(candidate, window, step, 1): a fall with two parameters, from a position and a velocity of each window."""
    pull, curve = parameters.T[:, :, None, None]
    position, velocity = corrections[..., :1], corrections[..., 1:]
    return (position + velocity * TIMES + pull * TIMES**3 / 9 + curve * np.sin(4 * TIMES))[..., None]


@pytest.fixture
def data() -> Data:
    generator = np.random.default_rng(0)
    initial = START_SD * generator.standard_normal((WINDOWS, 2))
    measured = outputs(TRUTH[None], initial[None])[0]
    measured = measured + NOISE * generator.standard_normal(measured.shape)
    mask = np.ones(measured.shape, dtype=bool)
    return Data(SPACE, measured, mask, np.array([NOISE]), np.full((WINDOWS, 2), START_SD))


def test_what_candidates_are_judged_by_is_what_is_found_there(data):
    solver = CmaEs(data, start=SPACE.nominal, seed=1)
    pairs = []
    for _ in range(66):
        trial = solver.ask()
        before, is_check = solver.best.error, len(np.unique(trial.parameters, axis=0)) == 1
        solver.tell(outputs(trial.parameters, trial.corrections), np.zeros((len(trial), WINDOWS), dtype=bool))
        if is_check:
            pairs.append((before, solver.best.error))
    claimed, exact = np.array(pairs[1:]).T  # before the first nothing is claimed
    np.testing.assert_allclose(claimed, exact, rtol=0.01)
    best = solver.best
    residual = data.residual(outputs(best.parameters[None], best.corrections[None]))
    assert best.error == pytest.approx(np.sqrt(np.square(residual).sum() / data.count), rel=0.01)
    np.testing.assert_allclose(best.parameters, TRUTH, atol=0.02)
