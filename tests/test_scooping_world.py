"""The robosuite scene of object scooping: the same plant, and a Panda that lifts the spatula."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("robosuite", reason="needs the extra robosuite")
pytest.importorskip("gymnasium", reason="needs the extra robosuite")

import gymnasium
import robosuite

from capture_cli.context.worlds import _robosuite, scooping
from capture_cli.context.worlds.world import World
from capture_cli.errors import OptionError
from capture_cli.model.fields import ModelFields
from capture_cli.model.tasks import load_task
from capture_cli.simulate.engine import Engine

CASES = [(0.0, 0.0), (0.5, 0.3), (1.0, 0.8), (-0.4, 0.7), (-1.0, -1.0)]  # com, scoop point


def make(com: float, scoop_point: float, **options) -> scooping.ObjectScooping:
    options = {"control_freq": 100, **options}
    return robosuite.make("ObjectScooping", robots="Panda", com=com, scoop_point=scoop_point, **options)


@pytest.fixture(scope="module")
def environment() -> scooping.ObjectScooping:
    """Held by the arm; `place` chooses what the next reset makes of it."""
    return make(0.0, 0.0, hard_reset=False)


@pytest.mark.parametrize(("com", "scoop_point"), CASES)
def test_same_trajectories_as_the_plant(com, scoop_point):
    task = load_task("scooping")
    episode = task.episodes(np.array([[scoop_point]]))
    fields = ModelFields(task.model, 1)
    task.write(fields, np.array([[com]]))
    plant = Engine(task.model).rollout(
        initial=episode.initial, controls=episode.inputs[:, : task.grid_steps], fields=fields
    )
    scene = make(com, scoop_point, driven_by="servos", control_freq=500)
    for step in range(task.grid_steps):
        np.testing.assert_allclose(scene.outputs, plant.sensors[0, step, :5], rtol=0, atol=1e-6)
        scene.spatula_target = episode.inputs[0, step]
        scene.step(np.zeros(scene.action_dim))


@pytest.mark.parametrize(("com", "away"), [(-1.0, 0.0), (0.3, 0.0), (1.0, 0.0), (0.2, 0.1), (-0.1, -0.1)])
def test_arm_lifts_and_label_tells_the_side(environment, com, away):
    environment.place(com, com + away)
    environment.reset()
    played = environment.lift()
    time, inputs, outputs = played.time, played.inputs, played.outputs
    assert environment.label == -np.sign(away)
    assert environment.reward() == (away == 0)
    assert len(time) == len(inputs) == len(outputs) == 41
    np.testing.assert_allclose(outputs[:, 3], inputs[:, 0], atol=5e-4)  # the arm stays under the scoop point
    assert outputs[-1, 4] == pytest.approx(0.0203, abs=2e-4)  # of 0.032: it lifts, and lags behind


@pytest.mark.parametrize(("scoop_point", "side"), [(-0.9, 1), (0.0, -1), (0.9, 1)])
def test_label_changes_at_a_tine_in_the_arms_hand_too(environment, scoop_point, side):
    for away, label in ((0.0508, 0.0), (0.0528, side)):
        environment.place(scoop_point + side * away, scoop_point)
        environment.reset()
        environment.lift()
        assert environment.label == label


def test_recordings_are_those_of_fresh_scenes():
    parameters, actions = np.array([0.2]), np.array([[0.5], [0.2]])
    task = load_task("scooping")
    for action, recorded in zip(actions, World(task).play(parameters, actions), strict=True):
        fresh = make(0.2, action[0]).lift()
        for name in ("time", "inputs", "outputs"):
            np.testing.assert_allclose(getattr(recorded, name), getattr(fresh, name), rtol=0, atol=1e-9)
    with pytest.raises(OptionError, match="rate = 60 Hz"):
        World(task, rate=60).play(parameters, actions)


def test_spatula_is_held_without_a_jerk(environment):
    environment.place(0.4, -0.7)
    environment.reset()
    before = environment.outputs
    environment.step(np.zeros(environment.action_dim))
    np.testing.assert_allclose(environment.outputs[3:], before[3:], atol=1e-4)
    assert before[3] == pytest.approx(-0.7 * 0.08)


def test_behind_gymnasium(environment):
    wrapped = gymnasium.make("capture/ObjectScooping-v0", com=0.0, scoop_point=0.0, horizon=2)
    observation, _ = wrapped.reset(seed=3)
    assert observation in wrapped.observation_space
    for expected in (False, True):
        observation, reward, terminated, truncated, information = wrapped.step(np.zeros(7, dtype=np.float32))
        assert observation in wrapped.observation_space
        assert (terminated, truncated) == (False, expected)
        assert reward == 0.0 and information == {"success": False}


def test_what_is_not_given_is_drawn_from_the_seed():
    drawn = []
    wrapped = gymnasium.make("capture/ObjectScooping-v0")
    for seed in (0, 0, 1):
        wrapped.reset(seed=seed)
        drawn.append(wrapped.unwrapped.environment.sim.model._model.body("rod").ipos[0])
    assert drawn[0] == drawn[1] != drawn[2]
    assert np.abs(drawn).max() <= 0.08


def test_unknown_driver():
    with pytest.raises(OptionError, match="driven_by = 'robot'"):
        make(0.0, 0.0, driven_by="robot")


def test_another_robosuite_is_refused(monkeypatch):
    monkeypatch.setattr(_robosuite.importlib.metadata, "version", lambda name: "1.6.0")
    with pytest.raises(OptionError, match=r"1\.6\.0 is installed"):
        _robosuite.patch_robosuite()
