"""Effects that the declared parameters imitate, wholly or but for a little: which are worth a fit."""

from __future__ import annotations

import numpy as np
import pytest
from balances import Made

from capture_cli.estimate.fit import Fit
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.solve.linearization import Data, Linearization
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.placed import Placed
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.select.candidates import Candidate, score_at_null
from capture_cli.select.narrow_peaks import NarrowPeaks
from capture_cli.select.reason import Reason

STEPS = 2000
SLIDER = Made.of("slider", episodes=1).prepared


@pytest.fixture
def fitted(monkeypatch):
    """A fit with one parameter, that leaves `left` (row,) of the noise's size: what candidates are scored against."""

    def fitted(effect, left: np.ndarray, response: np.ndarray) -> NarrowPeaks:
        noise = np.random.default_rng(0).standard_normal(STEPS)
        ramp = 1e3 * np.linspace(0, 1, STEPS)[None, :, None]
        space = ParameterSpace([Parameter("friction", "N", 0.0, 1.0, 0.5)])
        shape = (1, STEPS, 1)
        data = Data(space, np.zeros(shape), np.ones(shape, dtype=bool), np.ones(1), np.zeros((1, 0)))
        nothing = np.zeros((1, STEPS, 0))
        at = Linearization(data, np.array([0.5]), np.zeros((1, 0)), (left + noise)[None], ramp, nothing)

        def probe(part, fit, placed, probes, states):
            shares = (probes - effect.space.nominal) / effect.space.span
            change = shares.sum(axis=1)[:, None, None] * response
            return at.residual - change, np.zeros(len(probes), dtype=bool)

        fits = ModelFits(SLIDER, 1)
        monkeypatch.setattr(fits, "probe", probe)
        return NarrowPeaks(fits, SLIDER.part(np.arange(1)), Fit((), space, np.array([0.5]), at))

    return fitted


@pytest.mark.parametrize(("share", "is_tried"), [(0.0, False), (0.002, False), (0.015, True), (0.3, True)])
def test_what_is_imitated_but_for_a_little_is_tried(fitted, share, is_tried):
    """A gear's loss beside a fitted dry friction: 98 % of it is a friction that is always there. Differences say no
    more of sensitivities than half a percent.
    """
    ramp, wave = 1e3 * np.linspace(0, 1, STEPS), np.sin(np.linspace(0, 60, STEPS))
    own = share * wave * np.linalg.norm(ramp) / np.linalg.norm(wave)
    effect = REGISTRY.get("coulomb-friction")(SLIDER.task.model, "x")
    candidate = Candidate(Placed("coulomb-friction", effect))
    score_at_null(fitted(effect, left=4 * wave, response=ramp + own), candidate)
    assert (candidate.rejection is None) == is_tried
    if not is_tried:
        assert candidate.rejection.reason == Reason.IMITATED


def test_what_the_smallest_probes_overdo_is_probed_by_less(fitted, monkeypatch):
    """A spring that grows with the cube, on a wheel that turned far: a millionth of a range for one radian."""
    wave = np.sin(np.linspace(0, 60, STEPS))
    effect = REGISTRY.get("coulomb-friction")(SLIDER.task.model, "x")
    candidate = Candidate(Placed("coulomb-friction", effect))
    narrow = fitted(effect, left=wave, response=1e6 * wave)
    linear = narrow.fits.probe

    def bent(part, fit, placed, probes, states):
        """Beyond a thousandth of the range it turns the outputs upside down."""
        residual, diverged = linear(part, fit, placed, probes, states)
        share = (probes - effect.space.nominal)[:, 0] / effect.space.span[0]
        far = np.abs(share) > 1e-3
        residual[far] = -residual[far]
        return residual, diverged

    monkeypatch.setattr(narrow.fits, "probe", bent)
    score_at_null(narrow, candidate)
    assert candidate.rejection is None
    found = (candidate.start - effect.space.nominal)[0] / effect.space.span[0]
    assert found == pytest.approx(1e-6, rel=0.2)
