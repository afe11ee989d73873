"""Descents that get nowhere are given up, and those that get there are not."""

from __future__ import annotations

import numpy as np
import pytest

from capture_cli.identifiers.base import run
from capture_cli.identifiers.least_squares import LeastSquares
from capture_cli.linearization import Evidence, Trial
from capture_cli.parameters import Parameter, ParameterSpace

ROUNDS = 60
GAIN = 0.002  # of the first error, in each round


def creeping(to_beat: float) -> tuple[LeastSquares, int]:
    """A descent of an error of 5 whose sensitivities promise everything and whose rounds gain GAIN; rounds it took."""
    space = ParameterSpace([Parameter("a", "1", 0.0, 1.0, 0.5)])
    evidence = Evidence(
        space, np.zeros((1, 9, 1)), np.ones((1, 9, 1), dtype=bool), np.ones(1), np.zeros((1, 1))
    )
    told = 0

    def evaluate(trial: Trial):
        nonlocal told
        told += 1
        left = 5.0 * (1 - GAIN * told)
        moved = trial.parameters[:, 0] - trial.parameters[0, 0]
        inward = 1.0 if trial.parameters[0, 0] < 0.5 else -1.0
        outputs = np.tile((5.0 * inward * moved - left)[:, None, None, None], (1, 1, 9, 1))
        return outputs, np.zeros((len(trial), 1), dtype=bool)

    solver = LeastSquares(evidence, start=space.nominal, starts=1, rounds=ROUNDS, to_beat=to_beat)
    run(solver, evaluate)
    return solver, told


def test_a_descent_that_will_not_get_to_a_rivals_error_in_time_is_given_up():
    solver, rounds = creeping(to_beat=3.0)
    assert solver.gave_up
    assert rounds < ROUNDS / 3


@pytest.mark.parametrize("to_beat", [4.7, np.inf])
def test_a_descent_that_will_is_not(to_beat):
    solver, rounds = creeping(to_beat)
    assert not solver.gave_up
    assert rounds == ROUNDS
