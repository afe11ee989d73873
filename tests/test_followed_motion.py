"""Where windows begin of a machine that balances, of which not everything is measured."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from capture_cli.estimate.initial_states import of_windows as log_initial_states
from capture_cli.estimate.initial_states.nominal_motion import nominal_motion
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.split import NewSplit
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.coordinate_sources import measured_states
from capture_cli.model.tasks import load_task
from capture_cli.stages.import_log import import_log

BALANCING = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body name="cart">
<joint name="x" type="slide" axis="1 0 0" damping="0.5"/><geom type="box" size=".1 .1 .05" mass="1"/>
<body name="pole"><joint name="tilt" axis="0 1 0" damping="0.002"/>
<geom type="capsule" fromto="0 0 0 0 0 .6" size=".01" mass=".2"/></body></body></worldbody>
<actuator><motor name="drive" joint="x" ctrlrange="-20 20"/></actuator>
<sensor><jointpos name="tilt" joint="tilt"/></sensor></mujoco>"""
TASK = """format = 1
name = "balancing"
model = "model.xml"
[parameters.mass]
set = "body:cart:mass"
low = 0.5
high = 2.0
unit = "kg"
[inputs.drive]
column = "drive"
unit = "N"
[outputs.tilt]
column = "tilt"
unit = "rad"
[log]
time = "t"
window = 0.5
"""
STEPS, EVERY = 800, 5  # samples of a recording, every 10 ms


@pytest.fixture(scope="module")
def balanced(tmp_path_factory):
    """Task and log of a pole that is held upright on a cart somewhat heavier than modelled; its states (step, 4)."""
    folder = tmp_path_factory.mktemp("balancing")
    (folder / "model.xml").write_text(BALANCING)
    (folder / "task.toml").write_text(TASK)
    model = mujoco.MjModel.from_xml_string(BALANCING.replace('mass="1"', 'mass="1.02"'))
    data, random = mujoco.MjData(model), np.random.default_rng(1)
    rows, states = [], []
    for k in range(STEPS):
        there, tilt = data.qpos
        goal = 0.5 * np.sin(0.02 * k) + 0.3 * np.sin(0.047 * k)
        data.ctrl[0] = 3 * (there - goal) + 4 * data.qvel[0] + 45 * tilt + 9 * data.qvel[1]
        rows.append((0.01 * k, data.ctrl[0], tilt + random.normal(0, 1e-4)))
        states.append(np.concatenate([data.qpos, data.qvel]))
        mujoco.mj_step(model, data, EVERY)
    np.savetxt(folder / "run.csv", rows, delimiter=",", header="t,drive,tilt", comments="", fmt="%.10g")
    import_log(files=[folder / "run.csv"], task=str(folder / "task.toml"), out=folder / "log.zarr")
    task = load_task(str(folder / "task.toml"))
    return task, MeasuredLog.read(folder / "log.zarr"), np.array(states)


def test_what_is_not_measured_is_carried_along_with_what_is(balanced):
    task, log, states = balanced
    prepared = prepare(log, task, split=NewSplit("none"))
    initial, true = prepared.initial.states, states[prepared.windows.first]
    assert np.abs(states[:, 0]).max() > 0.3
    assert np.abs(initial.qpos[:, 0] - true[:, 0]).max() < 0.1
    assert np.abs(initial.qvel[:, 0] - true[:, 2]).max() < 0.05


def test_a_shorter_episode_stays_where_it_ends(balanced):
    task, log, _ = balanced
    half = log.time < log.time[STEPS // 2]
    both = np.concatenate([np.arange(STEPS), np.flatnonzero(half)])
    values = {name: getattr(log, name)[both] for name in ("time", "inputs", "outputs")}
    short = replace(log, **values, episode_ends=np.array([STEPS, len(both)]), recording=np.zeros(2, int))
    whole = log_initial_states.cut_log(short, task, None)
    paths = log_initial_states.followed_motion(short, task, whole, [0], np.array([1e-4]), 1)
    end = whole.grid_steps[1] - 1
    assert np.abs(paths.qpos[1, :end] - paths.qpos[0, :end]).max() < 1e-3
    assert (paths.qpos[1, end:] == paths.qpos[1, end]).all() and np.ptp(paths.qpos[0, end:, 0]) > 0.1


def test_a_simulation_by_the_inputs_alone_falls_over(balanced, monkeypatch):
    def by_inputs_alone(_, task, whole, *__):
        return nominal_motion(task, task.controls(whole.controls))

    task, log, states = balanced
    monkeypatch.setattr(log_initial_states, "followed_motion", by_inputs_alone)
    prepared = prepare(log, task, split=NewSplit("none"))
    assert np.abs(prepared.initial.states.qvel[:, 0] - states[prepared.windows.first, 2]).max() > 0.25


def test_the_way_that_comes_nearest_to_the_log_is_taken(balanced, monkeypatch):
    """Set anew, bodies may be thrown about by what they touch: then the simulation by the inputs alone stands."""
    task, log, _ = balanced
    good = prepare(log, task, split=NewSplit("none")).initial.states
    real = log_initial_states.followed_motion

    def thrown(*given):
        motion = real(*given)
        motion.qvel[...] += 10.0
        return motion

    monkeypatch.setattr(
        log_initial_states, "nominal_motion", lambda *_, **__: real(log, task, *followed_with)
    )
    followed_with = (log_initial_states.cut_log(log, task, None), [0], np.array([1e-4]), 1)
    monkeypatch.setattr(log_initial_states, "followed_motion", thrown)
    found = prepare(log, task, split=NewSplit("none")).initial.states
    assert np.abs(found.qvel - good.qvel).max() < 0.01


def test_measured_states_are_places_in_qpos_and_qvel():
    model = mujoco.MjModel.from_xml_string(BALANCING)
    assert [places.tolist() for places in measured_states(model, [0])] == [[1], [1]]
