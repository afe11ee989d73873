"""The starts of windows fitted alone: those that stand out are begun elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from capture_cli.identifiers import _window_starts
from capture_cli.identifiers._window_starts import fit_starts
from capture_cli.linearization import Evidence
from capture_cli.parameters import ParameterSpace

WINDOWS, STEPS = 5, 20


def outputs(offsets: np.ndarray) -> np.ndarray:
    """Of starts z (candidate, window): z; in the last window z - 1.2 from 0.3 on, and below it a valley at -0.6."""
    values = offsets.copy()
    z = offsets[:, -1]
    values[:, -1] = np.where(z < 0.3, 5 + (z + 0.6) ** 2, z - 1.2)
    return np.repeat(values[:, :, None, None], STEPS, axis=2)


def fitted() -> tuple[np.ndarray, np.ndarray]:
    """Offsets (window,) and the largest residual of each window."""
    noise = np.random.default_rng(0).normal(size=(WINDOWS, STEPS, 1))
    evidence = Evidence(
        ParameterSpace([]), noise, np.ones(noise.shape, dtype=bool), np.ones(1), np.ones((WINDOWS, 1))
    )

    def evaluate(keep, trial):
        offsets = np.zeros((len(trial), WINDOWS))
        offsets[:, keep] = trial.offsets[:, :, 0]
        return outputs(offsets)[:, keep], np.zeros((len(trial), len(keep)), dtype=bool)

    found = fit_starts(evidence, evaluate, np.full((WINDOWS, 1), -0.3), tolerance=1e-3)
    return found.offsets[:, 0], np.abs(found.residual).max(axis=1)


def test_a_window_that_got_stuck_is_begun_elsewhere(monkeypatch):
    offsets, residual = fitted()
    assert offsets[-1] == pytest.approx(1.2, abs=0.5) and residual.max() < 4
    monkeypatch.setattr(_window_starts, "SEARCHES", 0)
    offsets, residual = fitted()
    assert offsets[-1] < 0 and residual[-1] > 4 > residual[:-1].max()
