"""The robosuite scene of table air hockey: the same plant, and a Panda that holds the mallet; robosuite on MuJoCo 4."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("robosuite", reason="needs the extra robosuite")
pytest.importorskip("gymnasium", reason="needs the extra robosuite")

import gymnasium
import robosuite

from capture_cli.context.worlds import air_hockey
from capture_cli.context.worlds.world import World
from capture_cli.errors import OptionError
from capture_cli.model.effects import REGISTRY
from capture_cli.model.fields import ModelFields
from capture_cli.simulate.engine import Engine
from capture_cli.stages.record import record

PLANT = air_hockey.AirHockey()
# each strikes another wall; the last one only the far wall
ACTIONS = np.array([[-0.23, -0.07, 0.01, 0.5], [-0.23, 0.08, -0.02, 0.45], [-0.26, 0.005, 0.0, 0.5]])
PARAMETERS = {"left_friction": 0.033, "mallet_damping": -4.0, "left_damping": -9.0, "right_damping": -35.0}


def make(**options) -> air_hockey.TableAirHockey:
    options = {"control_freq": 100, "parameters": PARAMETERS, "horizon": 3000, **options}
    return robosuite.make("TableAirHockey", robots="Panda", **options)


@pytest.fixture(scope="module")
def environment() -> air_hockey.TableAirHockey:
    """Held by the arm; `place` chooses what the next reset makes of it."""
    return make(hard_reset=False)


@pytest.mark.parametrize("action", ACTIONS[1:], ids=["right wall", "far wall"])
def test_same_trajectories_as_the_plant(action):
    given = {"right_friction": 0.06, **PARAMETERS}
    fields = ModelFields(PLANT.model, 1)
    PLANT.write(fields, PLANT.space.to_vector(given)[None])
    episode = PLANT.episodes(action[None])
    plant = Engine(PLANT.model).rollout(
        initial=episode.initial, controls=episode.inputs[:, : PLANT.grid_steps], fields=fields
    )
    scene = make(parameters=given, mallet=action[:2], driven_by="servos", control_freq=1000)
    for step in range(PLANT.grid_steps):
        np.testing.assert_allclose(scene.outputs, plant.sensors[0, step], rtol=0, atol=1e-6)
        scene.tool_velocity = episode.inputs[0, step]
        scene.step(np.zeros(scene.action_dim))
    assert np.abs(plant.sensors[0, -1, :2] - PLANT.puck_start).max() > 0.1


def test_the_arm_strikes_late_and_as_far(environment):
    action = ACTIONS[0]
    environment.place({"right_friction": 0.05, **PARAMETERS}, action[:2])
    environment.reset()
    played = environment.strike(action)
    time, inputs, outputs = played.time, played.inputs, played.outputs
    assert not played.diverged and 0.5 < played.behind < 0.8
    assert len(time) == len(inputs) == len(outputs) == 201
    np.testing.assert_allclose(outputs[0], [*PLANT.puck_start, *action[:2]], atol=1e-9)
    sent = action[:2] + np.cumsum(inputs, axis=0) * 0.01
    np.testing.assert_allclose(outputs[-1, 2:], sent[-1], atol=0.005)  # it arrives
    along = (sent - outputs[:, 2:]) @ inputs[10] / np.linalg.norm(inputs[10])
    assert along.max() > 0.05  # it lags
    puck_start = outputs[:, 0] > PLANT.puck_start[0] + 0.002
    assert 0.1 < time[puck_start.argmax()] < 0.5
    assert outputs[-1, 0] > PLANT.puck_start[0] + 0.1


def test_the_arm_follows_like_a_damped_spring(environment):
    """With what a diagnosis of other strokes found (docs/worlds.md), the plant's mallet is where the arm's is."""
    action = ACTIONS[1]
    environment.place({"right_friction": 0.05, **PARAMETERS}, action[:2])
    environment.reset()
    played = environment.strike(action)
    inputs, outputs = played.inputs, played.outputs
    lag = REGISTRY.get("control-second-order-lag")
    arrived = inputs[None]
    for site, found in (("mallet_vx", (0.1058, 0.772)), ("mallet_vy", (0.1178, 0.633))):
        arrived = lag(PLANT.model, site).drive(arrived, np.array([found]), 0.01)
    moved = outputs[1:, 2:] - action[:2]
    error, error_of_servos = (
        np.abs(np.cumsum(sent[:-1], axis=0) * 0.01 - moved).max() for sent in (arrived[0], inputs)
    )
    assert error < 0.004 < 0.03 < error_of_servos


def test_recordings_are_those_of_fresh_scenes():
    parameters = PLANT.space.to_vector(PARAMETERS)
    for action, recorded in zip(ACTIONS[:2], World(PLANT).play(parameters, ACTIONS[:2]), strict=True):
        fresh = make(parameters=PLANT.space.to_dict(parameters), mallet=action[:2]).strike(action)
        for name in ("time", "inputs", "outputs"):
            np.testing.assert_allclose(getattr(recorded, name), getattr(fresh, name), rtol=0, atol=1e-9)
    with pytest.raises(OptionError, match="rate = 60 Hz"):
        World(PLANT, rate=60).play(parameters, ACTIONS)


def test_the_log_of_the_scene_is_one_of_the_task(tmp_path):
    made = record(
        task="air-hockey", world="robosuite", out=tmp_path / "log.zarr", episodes=2, noise=0.001, seed=1
    )
    assert (made.truth["world"], made.truth["robot"]) == ("robosuite", "Panda")
    assert made.truth["effects"] == {}
    assert made.log.outputs.shape == (402, 4) and made.log.actions.shape == (2, 4)
    first = made.log.outputs[[0, 201]]
    np.testing.assert_allclose(first[:, 2:], made.log.actions[:, :2], atol=0.005)
    assert np.isfinite(made.log.outputs).all()


def test_behind_gymnasium():
    wrapped = gymnasium.make("capture/TableAirHockey-v0", horizon=2)
    observation, _ = wrapped.reset(seed=3)
    assert observation in wrapped.observation_space
    for expected in (False, True):
        observation, reward, terminated, truncated, information = wrapped.step(np.zeros(7, dtype=np.float32))
        assert observation in wrapped.observation_space
        assert (terminated, truncated) == (False, expected)
        assert 0 < reward < 0.1 and information == {"success": False}


def test_what_is_not_given_is_drawn_from_the_seed():
    drawn = []
    wrapped = gymnasium.make("capture/TableAirHockey-v0")
    for seed in (0, 0, 1):
        wrapped.reset(seed=seed)
        scene = wrapped.unwrapped.environment
        drawn.append((scene.sim.model._model.geom("left_table").friction[0], *scene.outputs[2:]))
    assert drawn[0] == drawn[1] != drawn[2]
    assert all(0.03 <= friction <= 0.07 for friction, _, _ in drawn)


def test_what_makes_no_sense_is_refused(environment):
    with pytest.raises(OptionError, match="driven_by = 'robot'"):
        make(driven_by="robot")
    with pytest.raises(OptionError, match="unknown parameter 'friction'"):
        environment.place({"friction": 0.1}, None)


@pytest.mark.parametrize("controller", ["OSC_POSE", "JOINT_VELOCITY", "JOINT_POSITION"])
def test_robosuite_runs_on_this_mujoco(controller):
    config = robosuite.load_composite_controller_config(robot="Panda")
    part = robosuite.load_part_controller_config(default_controller=controller)
    config["body_parts"]["right"] = {**part, "gripper": config["body_parts"]["right"]["gripper"]}
    lift = robosuite.make(
        "Lift", robots="Panda", controller_configs=config, has_offscreen_renderer=False, use_camera_obs=False
    )
    before = lift.reset()["robot0_eef_pos"].copy()
    action = np.zeros(lift.action_dim)
    action[0] = 0.2
    for _ in range(10):
        observed, reward, _, _ = lift.step(action)
    moved = np.linalg.norm(observed["robot0_eef_pos"] - before)
    assert 1e-3 < moved < 0.2 and np.isfinite(reward)
