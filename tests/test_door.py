"""The door that a finger pushes ajar: its hinge against the formula, and what its parameters and actions do."""

from __future__ import annotations

import numpy as np
import pytest

from capture_cli.model.fields import ModelFields
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks.door import SETTINGS, Door
from capture_cli.simulate.engine import Engine, Keep
from capture_cli.simulate.simulator import Simulator

TASK = Door()
INERTIA = 0.236  # kg m^2, of panel and latch about the hinge


def random_parameters(count: int, seed: int) -> np.ndarray:
    return TASK.space.from_unit(np.random.default_rng(seed).random((count, len(TASK.space))))


def all_actions(each: int) -> np.ndarray:
    """A grid over the range of actions, (each * each, action)."""
    axes = (np.linspace(*ends, each) for ends in zip(TASK.actions.low, TASK.actions.high, strict=True))
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(TASK.actions))


@pytest.mark.parametrize(("friction", "damping"), [(0.2, 0.1), (0.5, 0.3), (0.8, 0.6)])
def test_a_door_that_swings_is_slowed_by_its_hinge(friction, damping):
    fields = ModelFields(TASK.model, 1)
    TASK.write(fields, np.array([[friction, damping, -10.0]]))
    initial = InitialStates(
        np.array([[0.2, -0.3, 0.0]]), np.array([[1.0, 0, 0]]), np.zeros((1, 0)), np.zeros(1)
    )
    moved = Engine(TASK.model).rollout(
        initial=initial, controls=np.zeros((1, 1000, 2)), fields=fields, keep=Keep(states=True)
    )
    # I dw/dt = -friction - damping w, from 1 rad/s to rest
    rate = damping / INERTIA
    until = np.log1p(damping / friction) / rate
    swung = (1 / rate) - (friction / damping) * until
    assert moved.qpos[0, -1, 0] - 0.2 == pytest.approx(swung, rel=0.02)
    assert abs(moved.qvel[0, -1, 0]) < 1e-4


def test_every_parameter_matters_to_many_pushes():
    parameters, simulator = random_parameters(40, seed=0), Simulator(TASK, threads=1)
    actions = TASK.actions.from_unit(np.random.default_rng(1).random((40, 2)))
    for column, name in enumerate(TASK.space.names):
        ends = [parameters.copy(), parameters.copy()]
        ends[0][:, column], ends[1][:, column] = TASK.space.low[column], TASK.space.high[column]
        low, high = (simulator.trajectories(end, actions)[0] for end in ends)
        assert (np.abs(high - low).max(axis=(1, 2)) > SETTINGS.within / 2).mean() > 0.5, name


def test_every_door_can_be_left_ajar_and_no_push_serves_them_all():
    parameters, actions = random_parameters(12, seed=2), all_actions(7)
    pairs = np.repeat(parameters, len(actions), axis=0), np.tile(actions, (len(parameters), 1))
    trajectories, diverged = Simulator(TASK, threads=1).trajectories(*pairs)
    assert not diverged.any()
    np.testing.assert_allclose(trajectories[:, -1], trajectories[:, -2], atol=0.01)  # it has come to rest
    success = TASK.success(pairs[1], trajectories).reshape(len(parameters), -1)
    assert success.any(axis=1).all()
    assert success.mean() < 0.2 and success.mean(axis=0).max() < 0.6


def test_the_finger_does_as_the_action_says_and_touches_nothing_before():
    actions = all_actions(2)
    episodes = TASK.episodes(actions)
    waited = round(SETTINGS.pause / TASK.timestep)
    assert episodes.inputs.shape == (4, TASK.grid_steps, 2)
    np.testing.assert_array_equal(episodes.inputs[:, :waited], 0)
    np.testing.assert_array_equal(episodes.inputs[:, waited, 0], actions[:, 1])
    pushed = episodes.inputs.sum(axis=1) * TASK.timestep
    np.testing.assert_allclose(pushed, [[SETTINGS.gap + SETTINGS.follow_through, 0]] * 4, atol=1e-9)
    trajectories, _ = Simulator(TASK, threads=1).trajectories(
        np.repeat(TASK.space.nominal[None], 4, 0), actions
    )
    assert (trajectories[:, -1] > 0.1).all()


def test_a_door_that_stands_ajar_is_worth_one():
    trajectories = np.full((2, 10, 1), SETTINGS.ajar)
    trajectories[1] += 1.1 * SETTINGS.within
    np.testing.assert_array_equal(TASK.success(np.zeros((2, 2)), trajectories), [True, False])
    assert TASK.reward(np.zeros((2, 2)), trajectories) == pytest.approx([1, np.exp(-1.1)])
