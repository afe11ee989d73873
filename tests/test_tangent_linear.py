"""Simulations near others, to first order: as good as simulated; and simulated where that does not hold."""

from __future__ import annotations

import numpy as np
import pytest
from setting_numbers import set_numbers
from test_model_fits import planted

from capture_cli.estimate.fit import SETTINGS as FIT
from capture_cli.estimate.model_fits import Effort, ModelFits
from capture_cli.estimate.prepared_log import SETTINGS as PREPARED_LOG
from capture_cli.estimate.solve.linearization import Linearization, columns
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.effects.placed import Placed


def linearized(prepared, placed, point, *, near, threads=1):
    """The linearization of all windows at `point` (parameter,), and whether all of it was simulated."""
    simulator = ModelFits(prepared, threads).simulator(placed)
    data = prepared.data(simulator)
    still = np.zeros(data.initial_sd.shape)
    x = data.space.to_unit(point)
    outputs, diverged, *exact = prepared.answer(simulator, columns(data, x, still, near=near))
    return Linearization.from_columns(data, x, still, outputs, diverged), exact != [False]


def off(found: Linearization, exact: Linearization) -> np.ndarray:
    """By which share each window's sensitivities are off, (window,), each column scaled to the same size."""
    both = [np.concatenate([at.by_parameter, at.by_initial], axis=2) for at in (found, exact)]
    size = np.linalg.norm(both[1], axis=(0, 1))
    apart, whole = ((v / np.where(size > 0, size, 1)) ** 2 for v in (both[0] - both[1], both[1]))
    return np.sqrt(apart.sum(axis=(1, 2)) / whole.sum(axis=(1, 2)))


@pytest.mark.parametrize(
    ("machine", "effect"),
    [
        ("slider", "quadratic-drag@x.drag=1.5"),  # a force
        ("slider", "control-lag@drive.time_constant=0.02"),
        ("slider", "sensor-low-pass@q.time_constant=0.02"),
        ("cart_pole", "viscous-damping@theta.damping=0.02"),
        ("arm", "payload@upper.mass=0.2"),
        ("finger", "friction-hardness@mcp.hardness=2"),
        # forces that remember
        ("slider", "hysteretic-friction@x.friction=0.3"),
        ("arm", "compliance@elbow.compliance=0.02"),
        ("slider", "viscoelastic-spring@x.stiffness=3"),
        ("slider", "loose-mass@x.mass=0.2"),
        ("cart_pole", "base-compliance@x.mobility=0.2"),
        ("pan_tilt", "servo-integral@tilt.ki=3"),
        ("arm", "force-supply-sag.sag=0.05"),
    ],
)
def test_first_order_is_as_good_as_simulations(tmp_path, machine, effect):
    prepared, truth = planted(tmp_path, effect, machine=machine)
    name, _, site = effect.partition(".")[0].partition("@")
    placed = [Placed(name, REGISTRY.get(name)(prepared.task.model, site or GLOBAL))]
    exactly, _ = linearized(prepared, placed, truth, near=False)
    found, exact = linearized(prepared, placed, truth, near=True)
    assert not exact
    np.testing.assert_array_equal(found.residual, exactly.residual)
    errors = off(found, exactly)
    assert np.median(errors) < 0.05 and errors.max() < 2 * PREPARED_LOG.agree


def test_windows_in_which_it_does_not_hold_are_simulated(tmp_path, monkeypatch):
    """Under a linearization for some 0.16 s of a motion that turns in 0.3 s."""
    prepared, truth = planted(tmp_path, "payload@upper.mass=0.2", machine="arm")
    set_numbers(monkeypatch, "capture_cli.simulate.tangent_linear", spacing=40)
    point = truth[: len(prepared.task.space)]
    found, exact = linearized(prepared, [], point, near=True)
    exactly, _ = linearized(prepared, [], point, near=False)
    errors = off(found, exactly)
    assert not exact and 0 < (errors == 0).sum() < len(errors)
    assert np.median(errors) < 2 * PREPARED_LOG.agree


def test_windows_of_no_more_than_the_first_steps_are_simulated(tmp_path, monkeypatch):
    prepared, truth = planted(tmp_path, "quadratic-drag@x.drag=1.5")
    set_numbers(monkeypatch, "capture_cli.simulate.tangent_linear", simulated=10_000)
    point = truth[: len(prepared.task.space)]
    found, _ = linearized(prepared, [], point, near=True)
    exactly, _ = linearized(prepared, [], point, near=False)
    np.testing.assert_array_equal(found.by_parameter, exactly.by_parameter)
    np.testing.assert_array_equal(found.by_initial, exactly.by_initial)


def test_nothing_is_taken_to_first_order_where_nothing_agrees(tmp_path, monkeypatch):
    prepared, truth = planted(tmp_path, "quadratic-drag@x.drag=1.5")
    set_numbers(monkeypatch, "capture_cli.estimate.prepared_log", agree=0.0)
    point = truth[: len(prepared.task.space)]
    found, exact = linearized(prepared, [], point, near=True)
    exactly, _ = linearized(prepared, [], point, near=False)
    assert exact
    np.testing.assert_array_equal(found.by_parameter, exactly.by_parameter)
    np.testing.assert_array_equal(found.by_initial, exactly.by_initial)


def test_threads_change_nothing(tmp_path):
    prepared, truth = planted(tmp_path, "payload@upper.mass=0.2", machine="arm")
    placed = [Placed("payload", REGISTRY.get("payload")(prepared.task.model, "upper"))]
    one, three = (linearized(prepared, placed, truth, near=True, threads=n)[0] for n in (1, 3))
    np.testing.assert_array_equal(one.by_parameter, three.by_parameter)
    np.testing.assert_array_equal(one.by_initial, three.by_initial)


def test_a_fit_ends_with_sensitivities_that_were_simulated(tmp_path):
    prepared, truth = planted(tmp_path, "quadratic-drag@x.drag=1.5")
    placed = [Placed("quadratic-drag", REGISTRY.get("quadratic-drag")(prepared.task.model, "x"))]
    start = 0.9 * truth
    rough = ModelFits(prepared, 1).fit(prepared, placed, start)
    fine = ModelFits(prepared, 1).fit(prepared, placed, start, effort=Effort(tolerance=FIT.exact))
    assert fine.at.exact and not rough.at.exact
    assert abs(fine.error - rough.error) < 1e-3
