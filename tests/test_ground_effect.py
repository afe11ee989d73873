"""Rotors that lift more near the floor: as in a plain loop of MuJoCo, found where it is planted, and nowhere else."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from diagnosing import diagnose, look_among
from machines import DRONE, build, run
from plain_loop import imported, looped

from capture_cli.log.arrays import Log
from capture_cli.log.input_sequences import HELD
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import cut
from capture_cli.model.effects.companion import companion_module
from capture_cli.model.effects.ground_effect import GroundEffect, lift_near_floor
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks import load_task
from capture_cli.simulate.multisine import multisine
from capture_cli.simulate.simulator import Simulator

QUADROTOR = """
<mujoco model="quadrotor">
  <option timestep="0.002"/>
  <default><geom contype="0" conaffinity="0"/><general dyntype="filterexact" dynprm="0.03"/></default>
  <worldbody>
    <geom name="cellar" type="plane" size="3 3 .1" pos="0 0 -.4"/>
    <geom name="wall" type="plane" size="3 3 .1" pos="-.2 0 0" euler="0 90 0"/>
    <geom name="ceiling" type="plane" size="3 3 .1" pos="0 0 3" euler="180 0 0"/>
    <body pos="0 0 .1" euler="5 0 0"><geom type="plane" size="3 3 .1"/></body>
    <body name="frame" pos="0 0 .3">
      <freejoint/>
      <geom type="box" size=".1 .1 .03" mass=".8"/>
      <site name="a" pos=".12 .12 .02"/><site name="b" pos="-.12 .12 .02" euler="4 0 0"/>
      <site name="c" pos="-.12 -.12 .02"/><site name="d" pos=".12 -.12 .02" euler="0 -3 0"/>
    </body>
  </worldbody>
  <actuator>
    <general name="a" site="a" gear="0 0 1 0 0 .02"/><general name="b" site="b" gear="0 .1 2 0 0 -.02"/>
    <general name="c" site="c" gear="0 0 1 0 0 .02" forcelimited="true" forcerange="0 2.2"/>
    <general name="d" site="d" gear="0 0 -1 0 0 -.02" gainprm="-1"/>
    <motor name="yaw" site="a" gear="0 0 0 0 0 1"/>
  </actuator>
  <sensor><framepos objtype="body" objname="frame"/><framequat objtype="body" objname="frame"/></sensor>
</mujoco>
"""
STEPS, RADIUS = 300, 0.17


def tape_of(model: mujoco.MjModel) -> np.ndarray:
    """Controls (step, actuator): near what carries the machine, and steps in them, each rotor's by itself."""
    time = model.opt.timestep * np.arange(STEPS)
    gears = np.linalg.norm(model.actuator_gear[:, :3], axis=1)
    swings = np.sign(np.sin(2 * np.pi * (3 + np.arange(model.nu)) * time[:, None] + 0.5))
    hover = 9.81 * model.body_subtreemass[0] / np.count_nonzero(gears) / np.where(gears > 0, gears, np.inf)
    return hover * (1 + 0.04 * swings) + 0.02 * swings * (gears == 0)


def law(height: float, radius: float) -> float:
    """Cheeseman and Bennett, down to half a radius."""
    return 1 / (1 - (radius / (4 * max(height, radius / 2))) ** 2)


def pushed(model: mujoco.MjModel, tape: np.ndarray, radius: float, rotors, floor: int) -> np.ndarray:
    """Sensors (step, column) of a plain loop, with what rotors lift over a floor applied as forces on their bodies."""
    data, now, recorded = mujoco.MjData(model), mujoco.MjData(model), []
    mujoco.mj_forward(model, data)
    for ctrl in tape:
        now.qpos[:], now.qvel[:], now.act[:], now.ctrl[:] = data.qpos, data.qvel, data.act, ctrl
        mujoco.mj_forward(model, now)
        data.ctrl[:], data.xfrc_applied[:] = ctrl, 0
        for rotor in rotors:
            site = model.actuator_trnid[rotor, 0]
            body = model.site_bodyid[site]
            normal = data.geom_xmat[floor].reshape(3, 3)[:, 2]
            height = (data.site_xpos[site] - data.geom_xpos[floor]) @ normal  # in the step before
            thrust = (
                now.actuator_force[rotor] * now.site_xmat[site].reshape(3, 3) @ model.actuator_gear[rotor, :3]
            )
            more = (law(height, radius) - 1) * thrust
            data.xfrc_applied[body, :3] += more
            data.xfrc_applied[body, 3:] += np.cross(now.site_xpos[site] - now.xipos[body], more)
        mujoco.mj_step(model, data)
        recorded.append(data.sensordata.copy())
    return np.array(recorded)


def still(model: mujoco.MjModel) -> InitialStates:
    return InitialStates(model.qpos0[None], np.zeros((1, model.nv)), np.zeros((1, model.na)), np.zeros(1))


@pytest.mark.parametrize(("xml", "rotors", "floor"), [(DRONE, 2, 0), (QUADROTOR, 4, 3)])
def test_it_is_a_force_at_each_rotor_as_in_a_plain_loop(xml, rotors, floor, tmp_path):
    model = build(xml)
    effect, tape = GroundEffect(model), tape_of(model)
    expected = pushed(model, tape, RADIUS, range(rotors), floor)
    found, _ = run(model, (effect, np.array([[RADIUS]])), tape=tape[None], initial=still(model))
    np.testing.assert_allclose(found[0], expected, rtol=0, atol=1e-11)
    plain, _ = run(model, tape=tape[None], initial=still(model))
    assert np.abs(plain[0] - expected).max() > 0.01
    path = tmp_path / "effects.py"
    path.write_text(companion_module("m.xml", "m", {"ground-effect": (effect, np.array([RADIUS]))}))
    gear = model.actuator_gear.copy()
    exported = looped(model, mujoco.MjData(model), imported(path).Effects(model), tape)
    np.testing.assert_allclose(exported, expected, rtol=0, atol=1e-11)
    assert np.array_equal(model.actuator_gear, gear)


def test_the_law_has_no_pole_and_the_nearest_floor_below_counts():
    floors, normals = np.array([[0.0, 0, 0], [0, 0, -1]]), np.array([[0.0, 0, 1], [0, 0, 1]])
    heights = np.array([2.0, 0.3, 0.051, 0.05, 0.02, 0.0, -0.9, -0.999, -2.0])
    rotors = np.stack([np.ones(9), np.zeros(9), heights], axis=-1)
    below = np.array([2.0, 0.3, 0.051, 0.05, 0.02, 0.0, 0.1, 0.001, 0.0])
    lift = lift_near_floor(rotors, floors, normals, radius=0.1)
    np.testing.assert_allclose(lift, [law(h, 0.1) for h in below], rtol=1e-12)
    assert lift[3:6] == pytest.approx(4 / 3)
    assert np.array_equal(lift_near_floor(rotors, floors, normals, radius=0.0), np.ones(9))


ACTUATOR = '<motor name="left" site="left" gear="0 0 1 0 0 .02" ctrllimited="true" ctrlrange="0 3.5"/>'


@pytest.mark.parametrize(
    "instead",
    [
        '<motor name="left" joint="up"/>',
        '<motor name="left" site="left" gear="0 0 0 0 0 1"/>',
        '<motor name="left" site="left" refsite="right" gear="0 0 1 0 0 0"/>',
        '<velocity name="left" site="left" kv="2" gear="0 0 1 0 0 0"/>',
    ],
)
def test_what_is_no_rotor_is_left_alone(instead):
    assert GroundEffect(build(DRONE)).rotors == [0, 1]
    assert DRONE.count(ACTUATOR) == 1
    assert GroundEffect(build(DRONE.replace(ACTUATOR, instead))).rotors == [1]


def test_it_sits_where_there_are_rotors_and_a_floor():
    assert GroundEffect.sites(build(DRONE)) == [""]
    assert GroundEffect(build(QUADROTOR)).floors == [0, 3]
    plane = '<geom name="floor" type="plane" size="3 3 .1"/>'
    wall = '<geom name="floor" type="plane" size="3 3 .1" euler="60 0 0"/>'
    for other in ("", wall, '<geom name="floor" type="box" size="3 3 .1"/>'):
        assert GroundEffect.sites(build(DRONE.replace(plane, other))) == []
    weightless = DRONE.replace("<option", '<option gravity="0 0 0"')
    assert GroundEffect.sites(build(weightless)) == [""]


TASK = """
format = 1
name = "drone"
model = "model.xml"
[parameters.left]
set = "actuator:left:gain"
low = 0.7
high = 1.3
unit = "1"
[parameters.right]
set = "actuator:right:gain"
low = 0.7
high = 1.3
unit = "1"
[inputs.left]
column = "left"
unit = "N"
[inputs.right]
column = "right"
unit = "N"
[outputs.across]
column = "across"
unit = "m"
[outputs.up]
column = "up"
unit = "m"
[outputs.pitch]
column = "pitch"
unit = "rad"
[log]
time = "t"
window = 0.4
"""
NOISE = np.array([5e-4, 5e-4, 1e-3])  # m, m, rad
EPISODES, SAMPLES, RATE = 5, 200, 250.0


@pytest.fixture
def task(tmp_path):
    (tmp_path / "model.xml").write_text(DRONE.replace('timestep="0.001"', 'timestep="0.004"'))  # for speed
    (tmp_path / "task.toml").write_text(TASK)
    return load_task(str(tmp_path / "task.toml"))


def flown(task, radius: float) -> MeasuredLog:
    """A log of flights 4 to 40 cm over the floor, by rotors that give 1.04 and 1.03 times their controls."""
    generator = np.random.default_rng(3)
    effect = GroundEffect(task.model)
    clock = np.arange(SAMPLES) / RATE
    hover = 9.81 * task.model.body_subtreemass[0] / 2
    both = [multisine(clock, 2, (0.5, 4.0), generator) @ [[1.0, 1.0], [0.2, -0.2]] for _ in range(EPISODES)]
    inputs = hover * (1 + 0.1 * np.concatenate(both))
    time, ends = np.tile(clock, EPISODES), SAMPLES * (1 + np.arange(EPISODES))
    episodes = [slice(end - SAMPLES, end) for end in ends]
    samples = Log(time, np.zeros((len(time), 3)), episodes, inputs)
    whole = cut(samples, None, task.timestep, [HELD, HELD])
    qpos, qvel = np.zeros((EPISODES, 3)), 0.05 * generator.standard_normal((EPISODES, 3))
    qpos[:, 1] = generator.uniform(0.0, 0.1, EPISODES)
    initial = InitialStates(qpos, qvel, np.zeros((EPISODES, 0)), np.zeros(EPISODES))
    truth = np.array([[1.04, 1.03, radius]])
    simulated = Simulator(task, [("ground-effect", effect)], threads=1).simulate(whole, initial, truth)
    return MeasuredLog(
        task=task.name,
        time=time,
        inputs=inputs,
        outputs=simulated.outputs[0][whole.mask] + NOISE * generator.standard_normal((len(time), 3)),
        episode_ends=ends,
        recording=np.zeros(EPISODES, dtype=np.int64),
        input_names=("left", "right"),
        input_units=("N", "N"),
        output_names=("across", "up", "pitch"),
        output_units=("m", "m", "rad"),
        recordings=({"name": "flown", "source": "simulated", "sha256": None},),
    )


@pytest.mark.parametrize("radius", [0.0, 0.1])
def test_it_is_found_with_its_radius_where_it_is_and_nowhere_else(radius, task, tmp_path, monkeypatch):
    look_among(monkeypatch, "ground-effect", "control-gain", "quadratic-drag", "medium-density", "payload")
    flown(task, radius).write(tmp_path / "log.zarr")
    document = diagnose(MeasuredLog.read(tmp_path / "log.zarr"), task, seed=0)
    found = {f"{e['name']}@{e['site']}": e["parameters"] for e in document["effects"]}
    assert list(found) == (["ground-effect@"] if radius else [])
    before, after = (document[when]["test"]["normalized"] for when in ("before", "after"))
    assert after < 1.1 and (before > 1.5 or not radius)
    if radius:
        assert found["ground-effect@"]["radius"]["value"] == pytest.approx(radius, rel=0.05)
