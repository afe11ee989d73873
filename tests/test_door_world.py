"""The robosuite scene of the door: the same plant, and a robot that holds the finger."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np
import pytest

pytest.importorskip("robosuite", reason="needs the extra robosuite")
pytest.importorskip("gymnasium", reason="needs the extra robosuite")

import robosuite

from capture_cli.context.worlds import door
from capture_cli.context.worlds.world import World
from capture_cli.model.fields import ModelFields
from capture_cli.simulate.engine import Engine

PLANT = door.Door()
ACTION = np.array([0.1, 0.45])
PARAMETERS = PLANT.space.to_vector({"hinge_friction": 0.3, "hinge_damping": 0.2, "finger_damping": -8.0})


def hinge_inertia(model: mujoco.MjModel, joint: str) -> float:
    """About the hinge, kg m^2."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    matrix = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    dof = model.joint(joint).dofadr[0]
    return matrix[dof, dof]


def test_the_door_is_robosuites_own():
    root = ElementTree.parse(
        Path(robosuite.__file__).parent / "models/assets/objects/door_lock.xml"
    ).getroot()
    root.remove(root.find("asset"))
    for geom in root.iter("geom"):
        geom.attrib.pop("material", None)
    stock = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    assert hinge_inertia(PLANT.model, "door_angle") == pytest.approx(hinge_inertia(stock, "hinge"), rel=0.02)
    np.testing.assert_allclose(
        PLANT.model.geom("panel").size, stock.geom("panel").size[[1, 0, 2]], rtol=1e-12
    )


def test_same_trajectories_as_the_plant():
    fields = ModelFields(PLANT.model, 1)
    PLANT.write(fields, PARAMETERS[None])
    episode = PLANT.episodes(ACTION[None])
    plant = Engine(PLANT.model).rollout(initial=episode.initial, controls=episode.inputs, fields=fields)
    scene = robosuite.make(
        "PushedDoor",
        robots="Panda",
        parameters=PLANT.space.to_dict(PARAMETERS),
        finger_y=ACTION[0],
        driven_by="servos",
        control_freq=500,
        horizon=3000,
    )
    for step in range(400):
        np.testing.assert_allclose(scene.outputs, plant.sensors[0, step], rtol=0, atol=1e-6)
        scene.tool_velocity = episode.inputs[0, step]
        scene.step(np.zeros(scene.action_dim))
    assert plant.sensors[0, 400, 0] > 0.3


@pytest.mark.parametrize("robot", ["Panda", "UR5e"])
def test_the_arm_pushes_late_and_as_far(robot):
    [played] = World(PLANT, robot).play(PARAMETERS, ACTION[None])
    assert not played.diverged and 0.3 < played.behind < 0.9
    assert played.outputs.shape == (201, 3)
    np.testing.assert_allclose(played.outputs[0], [0, -0.075, ACTION[0]], atol=1e-9)
    np.testing.assert_allclose(played.outputs[-1, 1:], [0.045, ACTION[0]], atol=0.01)  # it arrives
    assert 0.2 < played.outputs[-1, 0] < 1.2


def test_the_finger_gives_way_to_the_panel_as_little_as_the_arm():
    draw = np.random.default_rng(5)
    doors, actions = (space.from_unit(draw.random((6, len(space)))) for space in (PLANT.space, PLANT.actions))
    world = World(PLANT)
    arms = [world.play(*both)[0] for both in zip(doors, actions[:, None], strict=True)]
    fields = ModelFields(PLANT.model, len(doors))
    PLANT.write(fields, doors)
    steps = PLANT.timestep * np.arange(PLANT.grid_steps)
    controls = np.zeros((len(doors), len(steps), 2))
    for control, arm in zip(controls, arms, strict=True):  # servos that are told how the arm moves
        control[:, 0] = np.interp(steps, arm.time, np.gradient(arm.outputs[:, 1], arm.time))
    initial = PLANT.episodes(actions).initial
    plant = Engine(PLANT.model).rollout(initial=initial, controls=controls, fields=fields)
    angles = np.array([arm.outputs[-1, 0] for arm in arms])
    assert np.sqrt(np.mean((plant.sensors[:, -1, 0] - angles) ** 2)) < 0.1  # rad; of servos of 100 N s/m 0.4
