"""The simulator of windows: what several candidates share is simulated once, and nobody can tell."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from setting_numbers import set_numbers

from capture_cli.context.histories.action_library import Multisines, sequence_task
from capture_cli.estimate.initial_states.from_outputs import model_initial_states
from capture_cli.log.arrays import Log
from capture_cli.log.input_sequences import HELD
from capture_cli.log.windows import Windows, cut
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.effects.placed import Placed
from capture_cli.model.tasks import load_task
from capture_cli.simulate.simulator import Simulator


def cut_windows(task) -> Windows:
    """Windows of two short episodes."""
    time = np.arange(90) / 100
    samples = Log(time, np.zeros((90, 1)), [slice(0, 50), slice(50, 90)], inputs=np.sin(7 * time)[:, None])
    return cut(samples, 0.2, task.timestep, [HELD])


@pytest.fixture
def slider(slider_task):
    task = load_task(str(slider_task))
    windows = cut_windows(task)
    return task, windows, model_initial_states(task.model, len(windows)).states


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    points=st.lists(st.sampled_from([(1.0, 2.0), (1.0, 3.0), (2.0, 2.0)]), min_size=1, max_size=6),
    moves=st.lists(st.sampled_from([0.0, 0.01]), min_size=30, max_size=30),
)
def test_candidates_that_share_a_window_get_what_each_would_alone(slider, points, moves):
    task, windows, initial = slider
    count = len(windows)
    corrections = np.zeros((len(points), count, 2))
    corrections[:, :, 0] = np.array(moves[: len(points) * count]).reshape(len(points), count)
    together = Simulator(task, threads=1)
    outputs = together.simulate(windows, initial, np.array(points), corrections).outputs
    alone = Simulator(task, threads=1)
    for point, moved, found in zip(points, corrections, outputs, strict=True):
        expected = alone.simulate(windows, initial, np.array([point]), moved[None]).outputs[0]
        np.testing.assert_array_equal(found, expected)
    different = {
        (p, w, x) for p, row in zip(points, corrections[:, :, 0], strict=True) for w, x in enumerate(row)
    }
    assert together.rollouts == len(different)


def test_tapes_that_are_larger_than_what_is_run_at_a_time(slider, monkeypatch):
    task, windows, initial = slider
    delay = Placed("control-delay", REGISTRY.get("control-delay")(task.model, "drive"))
    points = np.array([[1.0, 2.0, 0.01], [2.0, 2.0, 0.02]])
    whole = Simulator(task, [delay], threads=1).simulate(windows, initial, points).outputs
    set_numbers(monkeypatch, "capture_cli.simulate.simulator", sequence_bytes=1)
    one_by_one = Simulator(task, [delay], threads=1).simulate(windows, initial, points).outputs
    np.testing.assert_array_equal(one_by_one, whole)


@pytest.mark.parametrize("name", ["stribeck-friction", None])
def test_outputs_that_are_larger_than_what_is_run_at_a_time(slider, name, monkeypatch):
    task, windows, initial = slider
    effects = [Placed(name, REGISTRY.get(name)(task.model, "x"))] if name else []
    points = np.array([[1.0, 2.0], [1.0, 3.0], [2.0, 2.0]])
    if name:
        points = np.hstack([points, np.repeat(effects[0].effect.space.high[None] / 2, 3, axis=0)])
    whole = Simulator(task, effects, threads=1).simulate(windows, initial, points).outputs
    set_numbers(monkeypatch, "capture_cli.simulate.simulator", sensor_bytes=1)
    one_by_one = Simulator(task, effects, threads=1).simulate(windows, initial, points).outputs
    np.testing.assert_array_equal(one_by_one, whole)


@pytest.mark.parametrize(
    ("name", "site", "value"),
    [("control-delay", "drive", 0.013), ("control-lag", "drive", 0.03), ("sensor-clock-rate", GLOBAL, 0.02)],
)
def test_inputs_that_are_read_off_the_log_drive_as_those_kept_do(slider, name, site, value, monkeypatch):
    task, _, initial = slider
    points = np.array([[1.0, 2.0, value], [2.0, 2.0, value / 2]])
    outputs = []
    for bound in (math.inf, 0):
        set_numbers(monkeypatch, "capture_cli.log.input_sequences", kept_bytes=bound)
        windows = cut_windows(task)
        placed = Placed(name, REGISTRY.get(name)(task.model, site))
        for effects, at in (([placed], points), ([], points[:, :2])):
            outputs.append(Simulator(task, effects, threads=1).simulate(windows, initial, at).outputs)
    for kept, read in zip(outputs[:2], outputs[2:], strict=True):
        np.testing.assert_array_equal(kept, read)


def test_without_offsets_too(slider):
    task, windows, initial = slider
    simulator = Simulator(task, threads=1)
    outputs = simulator.simulate(windows, initial, np.array([[1.0, 2.0], [2.0, 2.0], [1.0, 2.0]])).outputs
    np.testing.assert_array_equal(outputs[0], outputs[2])
    assert np.abs(outputs[0] - outputs[1]).max() > 1e-4
    assert simulator.rollouts == 2 * len(windows)


def test_episodes_are_the_same_however_many_are_simulated_at_once(slider, monkeypatch):
    task = sequence_task(slider[0], Multisines({"drive": 3.0}), points=5, window=0.1)
    generator = np.random.default_rng(0)
    parameters = task.space.from_unit(generator.random((10, len(task.space))))
    actions = task.draw_actions(generator.random((10, len(task.actions))))
    at_once, diverged = Simulator(task, threads=1).trajectories(parameters, actions)
    set_numbers(monkeypatch, "capture_cli.simulate.simulator", episodes=4)
    simulator = Simulator(task, threads=1)
    trajectories, in_parts = simulator.trajectories(parameters, actions)
    np.testing.assert_array_equal(trajectories, at_once)
    np.testing.assert_array_equal(in_parts, diverged)
    assert simulator.rollouts == 10
