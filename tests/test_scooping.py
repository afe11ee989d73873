"""Object scooping: the label is what contact physics makes of scoop point and centre of mass."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_cli.model.tasks import load_task
from capture_cli.simulate.simulator import Simulator

IN_REACH = st.floats(-1.0, 1.0)
LABEL_CHANGES = 0.0494  # half-lengths


@pytest.fixture(scope="module")
def scooping() -> Simulator:
    return Simulator(load_task("scooping"), threads=1)


def observe(simulator: Simulator, com: np.ndarray, scoop_point: np.ndarray) -> np.ndarray:
    """The one number observed, of the shape of `com`."""
    com, scoop_point = np.broadcast_arrays(com, scoop_point)
    observed, diverged = simulator.trajectories(com.reshape(-1, 1), scoop_point.reshape(-1, 1))
    assert observed.shape == (com.size, 1, 1)
    assert not diverged.any()
    return observed.reshape(com.shape)


def test_lift_at_the_centre_of_mass_succeeds_everywhere(scooping):
    com = np.linspace(-1, 1, 501)[:, None]
    trajectories, _ = scooping.trajectories(com, com)
    assert scooping.task.success(com, trajectories).all()
    assert (scooping.task.reward(com, trajectories) == 1).all()


def test_label_is_monotonic_and_symmetric(scooping):
    grid = np.linspace(-1, 1, 34)
    label = observe(scooping, grid[:, None], grid[None])
    assert (np.diff(label, axis=0) >= 0).all()  # a centre of mass farther right tilts it to the right
    assert (np.diff(label, axis=1) <= 0).all()
    assert set(np.unique(label)) == {-1.0, 0.0, 1.0}
    np.testing.assert_array_equal(label, -label[::-1, ::-1])


@pytest.mark.parametrize("side", [-1, 1])
def test_label_changes_at_a_tine(scooping, side):
    scoop_point = side * np.linspace(-0.95, 0.945, 12)
    assert not observe(scooping, scoop_point + side * (LABEL_CHANGES - 2e-4), scoop_point).any()
    tilted = observe(scooping, scoop_point + side * (LABEL_CHANGES + 2e-4), scoop_point)
    np.testing.assert_array_equal(tilted, side)


@settings(deadline=None, max_examples=30)
@given(com=IN_REACH, scoop_point=IN_REACH)
def test_distance_is_that_of_scoop_point_and_centre_of_mass(com, scoop_point):
    simulator = Simulator(load_task("scooping-distance"), threads=1)
    distance = observe(simulator, np.array([com]), np.array([scoop_point]))
    np.testing.assert_allclose(distance, abs(com - scoop_point), atol=1e-4)


def test_distance_calls_a_success_what_the_lift_does(scooping):
    generator = np.random.default_rng(0)
    com = generator.uniform(-1, 1, (300, 1))
    scoop_point = np.clip(com + generator.uniform(-0.2, 0.2, com.shape), -1, 1)
    lifted, _ = scooping.trajectories(com, scoop_point)
    simulator = Simulator(load_task("scooping-distance"), threads=1)
    touched, _ = simulator.trajectories(com, scoop_point)
    agree = scooping.task.success(scoop_point, lifted) == simulator.task.success(scoop_point, touched)
    at_the_edge = np.abs(np.abs(com - scoop_point) - LABEL_CHANGES)[:, 0] < 1e-3
    assert (agree | at_the_edge).all()
    reward = simulator.task.reward(scoop_point, touched)
    order = np.argsort(touched[:, -1, 0])
    assert (np.diff(reward[order]) <= 0).all()


def test_a_rod_left_lying_is_no_success(scooping):
    task = scooping.task
    lying = np.zeros((3, 1, 5))
    lying[:, 0, 2] = [-1e-3, 0.0, 1e-3]
    label = task.observe(lying)
    np.testing.assert_array_equal(label[:, 0, 0], [-1, 1, 1])
    assert not task.success(np.zeros((3, 1)), label).any()


def test_same_bytes_for_any_number_of_threads(scooping):
    generator = np.random.default_rng(1)
    com, scoop_point = generator.uniform(-1, 1, (2, 64, 1))
    one = Simulator(load_task("scooping"), threads=1).trajectories(com, scoop_point)
    two = scooping.trajectories(com, scoop_point)
    assert one[0].tobytes() == two[0].tobytes()
