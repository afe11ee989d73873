"""Descents that get nowhere are stopped early, and those that get there are not."""

from __future__ import annotations

import numpy as np
import pytest

from capture_cli.estimate.solve.base import run
from capture_cli.estimate.solve.least_squares import EarlyStop, LeastSquares
from capture_cli.estimate.solve.linearization import Data, Trial, box_step
from capture_cli.model.parameters import Parameter, ParameterSpace

ROUNDS, ROWS = 60, 200
GAIN = 0.002  # of the first error, in each round


def creeping(to_beat: float) -> tuple[LeastSquares, int]:
    """A descent of an error of 5 whose sensitivities promise everything and whose rounds gain GAIN; rounds it took."""
    space = ParameterSpace([Parameter("a", "1", 0.0, 1.0, 0.5)])
    signs = np.random.default_rng(0).choice([-1.0, 1.0], ROWS)[
        :, None
    ]  # so that what is left looks like noise
    shape = (1, ROWS, 1)
    data = Data(space, np.zeros(shape), np.ones(shape, dtype=bool), np.ones(1), np.zeros((1, 1)))
    told = 0

    def evaluate(trial: Trial):
        nonlocal told
        told += 1
        left = 5.0 * (1 - GAIN * told)
        moved = trial.parameters[:, 0] - trial.parameters[0, 0]
        inward = 1.0 if trial.parameters[0, 0] < 0.5 else -1.0
        outputs = (5.0 * inward * moved - left)[:, None, None, None] * signs
        return outputs, np.zeros((len(trial), 1), dtype=bool)

    solver = LeastSquares(data, start=space.nominal, starts=1, rounds=ROUNDS, early_stop=EarlyStop(to_beat))
    run(solver, evaluate)
    return solver, told


def test_a_descent_that_will_not_get_to_a_rivals_error_in_time_is_given_up():
    solver, rounds = creeping(to_beat=3.0)
    assert solver.stopped_early
    assert rounds < ROUNDS / 3


@pytest.mark.parametrize("to_beat", [4.7, np.inf])
def test_a_descent_that_will_is_not(to_beat):
    solver, rounds = creeping(to_beat)
    assert not solver.stopped_early
    assert rounds == ROUNDS


def linear_machine(windows: int, states: int, rows: int, free: np.ndarray):
    """Data of a machine that is linear in two parameters and its initial states, and what its simulations give."""
    generator = np.random.default_rng(3)
    by_parameter = generator.normal(size=(windows, rows, 2))
    by_initial = generator.normal(size=(windows, rows, states))
    space = ParameterSpace([Parameter(n, "1", 0.0, 1.0, 0.5) for n in "ab"])
    measured = by_parameter.sum(axis=2)[..., None] * 0.3 + generator.normal(size=(windows, rows, 1))
    data = Data(space, measured, np.ones(measured.shape, dtype=bool), np.ones(1), 0.1 * free)
    simulated = []

    def evaluate(trial: Trial):
        moves = np.concatenate(
            [np.repeat(trial.parameters[:, None], windows, axis=1), trial.corrections], axis=2
        )
        simulated.append(len(np.unique(moves.reshape(-1, moves.shape[2]), axis=0)))
        outputs = np.einsum("wrp,tp->twr", by_parameter, trial.parameters)
        outputs += np.einsum("wrs,tws->twr", by_initial, trial.corrections)
        return outputs[..., None], np.zeros((len(trial), windows), dtype=bool)

    return data, evaluate, simulated


def test_what_is_known_of_held_starts_is_not_measured_again_where_they_are_freed():
    windows, states, rows = 5, 3, 40
    free = np.ones((windows, states))
    held = free.copy()
    held[:, 0] = 0.0  # of no window
    held[::2, 1] = 0.0  # of some
    few, evaluate, _ = linear_machine(windows, states, rows, held)
    before = LeastSquares(few, start=few.space.nominal, starts=1)
    best = run(before, evaluate)

    data, evaluate, simulated = linear_machine(windows, states, rows, free)
    known = before.at.known_in(data, len(data.space), states)
    known = LeastSquares(data, start=best.parameters, corrections=best.corrections, starts=1, known=known)
    known.tell(*evaluate(known.ask()))
    full = LeastSquares(data, start=best.parameters, corrections=best.corrections, starts=1)
    full.tell(*evaluate(full.ask()))
    assert simulated[0] < simulated[1]
    assert (known.at.updates, full.at.updates) == (before.at.updates, 0)
    for name in ("residual", "by_parameter", "by_initial"):
        np.testing.assert_allclose(getattr(known.at, name), getattr(full.at, name), rtol=1e-6, atol=1e-6)
    free_best = run(known, evaluate)
    assert free_best.error <= best.error
    assert known.at.updates == 0


@pytest.mark.parametrize("diverges", (False, True))
def test_a_window_whose_start_runs_away_does_not_keep_the_others_from_their_step(diverges):
    """The slope of one window's start leads over a cliff, which costs more than all other windows gain."""
    windows, rows = 20, 30
    generator = np.random.default_rng(5)
    space = ParameterSpace([Parameter(n, "1", 0.0, 1.0, 0.5) for n in "ab"])
    by_parameter = generator.normal(size=(windows, rows, 2)) * 20.0
    by_initial = generator.normal(size=(windows, rows))
    truth = np.array([0.3, 0.8])
    measured = by_parameter @ truth + generator.normal(size=(windows, rows))
    measured[0] += 6.0 * by_initial[0]
    data = Data(
        space, measured[..., None], np.ones((windows, rows, 1), dtype=bool), np.ones(1), np.ones((windows, 1))
    )
    simulated = 0

    def evaluate(trial: Trial):
        nonlocal simulated
        simulated += len(trial) * (windows if trial.windows is None else len(trial.windows))
        outputs = np.einsum("wrp,cp->cwr", by_parameter, trial.parameters) + by_initial * trial.corrections
        over = trial.corrections[..., 0] > 0.5
        over[:, 1:] = False
        outputs += 1e3 * over[..., None]
        return outputs[..., None], over & diverges

    solver = LeastSquares(data, start=space.nominal, starts=1, rounds=ROUNDS)
    best = run(solver, evaluate)
    np.testing.assert_allclose(best.parameters, truth, atol=0.01)
    assert simulated < 100 * windows  # held back by the one it takes 306 of all


def test_a_step_of_initial_states_alone_that_fails_leaves_the_trust_region():
    space = ParameterSpace([Parameter("a", "1", 0.0, 1.0, 0.5)])  # shows nothing
    data = Data(space, np.zeros((1, ROWS, 1)), np.ones((1, ROWS, 1), dtype=bool), np.ones(1), np.ones((1, 1)))
    signs = np.random.default_rng(0).choice([-1.0, 1.0], ROWS)

    def evaluate(trial: Trial):
        moved = trial.corrections[:, :, 0]
        outputs = np.where(moved < 0.05, 5.0 * (1 - moved), 10.0)  # promises what it does not keep
        return (outputs[..., None] * signs)[..., None], np.zeros(outputs.shape, dtype=bool)

    solver = LeastSquares(data, start=space.nominal, starts=1, rounds=ROUNDS)
    assert run(solver, evaluate).error == pytest.approx(5.0)


def test_a_box_may_be_as_thin_as_a_point():
    hessian, gradient = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([3.0, 1.0])
    thin = box_step(hessian, gradient, np.array([0.2, -1.0]), np.array([0.2, 1.0]))
    assert thin == pytest.approx([0.2, 0.9])
