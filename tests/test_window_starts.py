"""The initial states of windows fitted alone: those that stand out are begun elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from setting_numbers import set_numbers

from capture_cli.estimate.initial_states import refined as _window_starts
from capture_cli.estimate.initial_states.refined import fit_initial_states
from capture_cli.estimate.solve.linearization import Data
from capture_cli.model.parameters import ParameterSpace

WINDOWS, STEPS = 5, 20


def outputs(corrections: np.ndarray) -> np.ndarray:
    """Of initial states z (candidate, window): z; in the last window z - 1.2 from 0.3 on, and below it a valley at
    -0.6.
    """
    values = corrections.copy()
    z = corrections[:, -1]
    values[:, -1] = np.where(z < 0.3, 5 + (z + 0.6) ** 2, z - 1.2)
    return np.repeat(values[:, :, None, None], STEPS, axis=2)


def fitted(also: float | None = None, counted: list[int] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Corrections (window,) and the largest residual of each window; counted: how many windows each call simulates."""
    noise = np.random.default_rng(0).normal(size=(WINDOWS, STEPS, 1))
    data = Data(
        ParameterSpace([]), noise, np.ones(noise.shape, dtype=bool), np.ones(1), np.ones((WINDOWS, 1))
    )

    def evaluate(keep, trial):
        if counted is not None:
            counted.append(len(trial) * len(keep))
        corrections = np.zeros((len(trial), WINDOWS))
        corrections[:, keep] = trial.corrections[:, :, 0]
        return outputs(corrections)[:, keep], np.zeros((len(trial), len(keep)), dtype=bool)

    also = None if also is None else np.full((WINDOWS, 1), also)
    found = fit_initial_states(data, evaluate, np.full((WINDOWS, 1), -0.3), tolerance=1e-3, also=also)
    return found.corrections[:, 0], np.abs(found.residual).max(axis=1)


def test_a_window_that_got_stuck_is_begun_elsewhere(monkeypatch):
    corrections, residual = fitted()
    assert corrections[-1] == pytest.approx(1.2, abs=0.5) and residual.max() < 4
    set_numbers(monkeypatch, _window_starts, searches=0)
    corrections, residual = fitted()
    assert corrections[-1] < 0 and residual[-1] > 4 > residual[:-1].max()


def test_a_window_that_stays_stuck_is_begun_at_other_places_each_time(monkeypatch):
    """From a step down at 0.3 on the next draws may be in the valley that begins at 1.33: of the first 16 none is."""

    def narrow(corrections: np.ndarray) -> np.ndarray:
        values, z = corrections.copy(), corrections[:, -1]
        values[:, -1] = np.select([z < 0.3, z < 1.33], [6.0, 5.0], z - 1.4)
        return np.repeat(values[:, :, None, None], STEPS, axis=2)

    monkeypatch.setitem(globals(), "outputs", narrow)
    set_numbers(monkeypatch, _window_starts, searches=1)
    assert fitted()[1][-1] > 4
    monkeypatch.undo()
    monkeypatch.setitem(globals(), "outputs", narrow)
    assert fitted()[1][-1] < 4


def test_windows_begin_at_either_of_two_starts(monkeypatch):
    set_numbers(monkeypatch, _window_starts, searches=0)
    (alone, left), (corrections, residual) = fitted(), fitted(also=0.5)
    assert alone[-1] < 0.3 < corrections[-1], "out of its valley"
    assert residual[-1] < left[-1]
    assert np.allclose(corrections[:-1], alone[:-1], atol=0.3), "where the first start is as good"


def test_only_windows_that_get_better_are_linearised(monkeypatch):
    """A round asks for one simulation of every window, and for the differences of those that it helped."""
    set_numbers(monkeypatch, _window_starts, searches=0)
    counted: list[int] = []
    fitted(counted=counted)
    first, *rounds = counted
    assert first == 2 * WINDOWS, "one simulation and one difference each"
    assert rounds and max(rounds) <= WINDOWS


def test_all_descents_of_a_window_are_simulated_at_once(monkeypatch):
    set_numbers(monkeypatch, _window_starts, searches=1, drawn=0)
    hidden, together = np.linspace(-1.0, 1.0, 5)[:, None], []
    data = Data(
        ParameterSpace([]),
        np.random.default_rng(0).normal(size=(WINDOWS, STEPS, 1)),
        np.ones((WINDOWS, STEPS, 1), dtype=bool),
        np.ones(1),
        np.ones((WINDOWS, 1)),
        hidden_tried=hidden,
    )

    def evaluate(keep, trial):
        z = trial.corrections[:, :, 0]
        stuck = np.where(z < 0.3, 5 + (z + 0.6) ** 2, z - 1.2)
        together.append(np.bincount(keep)[-1])
        values = np.where(keep == WINDOWS - 1, stuck, z)
        return np.repeat(values[:, :, None, None], STEPS, axis=2), np.zeros(z.shape, dtype=bool)

    found = fit_initial_states(data, evaluate, np.full((WINDOWS, 1), -0.3), tolerance=1e-3)
    assert found.corrections[-1, 0] == pytest.approx(1.2, abs=0.5) and np.abs(found.residual).max() < 4
    assert max(together) == _window_starts.SETTINGS.descents
