"""A sensor that holds no steady value: the law, what it holds when a window begins, and found where it is planted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosing import diagnose, look_among
from machines import build
from recorded_logs import record_log
from scipy.signal import bilinear, lfilter, lsim

from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.effects.base import Reports, SeenLog
from capture_cli.model.effects.sensor_high_pass import SensorHighPass, high_passed, integrated
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.mjcf_file import MjcfFile

TABLE = """
<mujoco model="table">
  <option timestep="0.004" gravity="0 0 0" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="coil">
      <joint name="x" type="slide" axis="1 0 0" stiffness="200" damping="10"/>
      <geom size=".03" mass=".5"/>
      <body name="table"><geom size=".05" mass="1.5"/><site name="cell"/></body>
    </body>
  </worldbody>
  <actuator><motor name="drive" joint="x" gear="10" ctrllimited="true" ctrlrange="-3 3"/></actuator>
  <sensor>
    <jointpos name="x" joint="x"/><force name="cell" site="cell"/><torque name="twist" site="cell"/>
    <accelerometer name="shock" site="cell"/><gyro name="gyro" site="cell"/><velocimeter name="v" site="cell"/>
    <framequat name="attitude" objtype="body" objname="table"/><actuatorfrc name="current" actuator="drive"/>
  </sensor>
</mujoco>
"""
TASK = """
format = 1
name = "table"
model = "model.xml"
[parameters.damping]
set = "joint:x:damping"
low = 0.0
high = 40.0
unit = "N s/m"
[inputs.drive]
column = "drive"
unit = "A"
[outputs.x]
column = "x"
unit = "m"
[outputs.cell]
column = ["fx", "fy", "fz"]
unit = "N"
[log]
time = "t"
window = 0.6
"""
RATE, TIMESTEP, STEPS = 0.7, 0.004, 1000  # 1/s, s
EFFECT = "sensor-high-pass@cell"
MODELLED = {"gravity": "0 0 0", "axis": "1 0 0"}
WEIGHT = np.array([0.0, 0.0, 1.5 * 9.81])  # N, of the table


def test_it_is_the_bilinear_transform_of_the_filter():
    series = np.random.default_rng(0).normal(size=(STEPS, 3))
    series[0] = 0.0  # the transform is at rest before the first row
    expected = lfilter(*bilinear([1 / RATE, 0], [1 / RATE, 1], fs=1 / TIMESTEP), series, axis=0)
    np.testing.assert_allclose(high_passed(series, rate=RATE, timestep=TIMESTEP), expected, atol=1e-12)


@pytest.mark.parametrize("rate", [0.1, RATE, 12.0])
def test_it_is_the_filter_in_continuous_time(rate):
    time = TIMESTEP * np.arange(STEPS)
    series = 2.0 + np.sin(7 * time) + time**2
    _, expected, _ = lsim(([1.0, 0.0], [1.0, rate]), series, time)
    found = high_passed(series[:, None], rate=rate, timestep=TIMESTEP)[:, 0]
    np.testing.assert_allclose(found, expected, atol=2e-4)
    steady = high_passed(np.ones((STEPS, 1)), rate=rate, timestep=TIMESTEP)[:, 0]
    np.testing.assert_allclose(steady, np.exp(-rate * time), atol=5e-4)


def test_it_sits_at_what_is_coupled_so():
    assert SensorHighPass.sites(build(TABLE)) == ["cell", "twist", "shock", "current"]


def logged() -> tuple[SensorHighPass, np.ndarray, np.ndarray]:
    """The effect in a log of two episodes that it made, sensordata (step, column) as they were and as reported."""
    model = build(TABLE)
    effect = SensorHighPass(model, "cell")
    true = np.random.default_rng(0).normal(1.0, 1.0, (2, STEPS, model.nsensordata)).cumsum(axis=1)
    reported = effect.measure(true, np.full((2, 1), RATE), TIMESTEP)
    reports = Reports(
        TIMESTEP * np.tile(np.arange(STEPS), 2),
        reported.reshape(2 * STEPS, -1).copy(),
        [slice(0, STEPS), slice(STEPS, 2 * STEPS)],
        np.zeros(model.nsensordata),
    )
    effect.look_in(
        SeenLog(
            window=0.2,
            longest=TIMESTEP * STEPS,
            logged=frozenset(range(model.nsensordata)),
            seen={},
            reports=reports,
        )
    )
    return effect, true, reported


def test_a_window_goes_on_from_what_was_reported_before_it():
    effect, true, reported = logged()
    begun = [(0, 0), (0, 700), (1, 0), (1, 900)]
    inside = np.stack([true[episode, k : k + 100] for episode, k in begun])
    first = np.array([STEPS * episode + k for episode, k in begun])
    found = effect.measure(inside, np.full((4, 1), RATE), TIMESTEP, states=np.zeros((4, 3)), first=first)
    expected = np.stack([reported[episode, k : k + 100] for episode, k in begun])
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert not np.array_equal(inside[1], expected[1])


def test_what_it_held_when_the_episode_began_is_a_state_and_decays():
    effect, true, _ = logged()
    values, first = np.full((2, 1), RATE), np.array([700, 700])
    states = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    none, held = effect.measure(
        np.repeat(true[:1, 700:800], 2, 0), values, TIMESTEP, states=states, first=first
    )
    less = (none - held)[:, effect.columns]
    assert less[0, 1] > 0 and not less[:, [0, 2]].any()
    np.testing.assert_allclose(less[:, 1], less[0, 1] * np.exp(-RATE * TIMESTEP * np.arange(100)), rtol=1e-6)


def test_at_null_it_changes_nothing_whatever_it_held():
    effect, true, _ = logged()
    states = np.array([[1.0, -2.0, 3.0]] * 2)
    found = effect.measure(true, np.zeros((2, 1)), TIMESTEP, states=states, first=np.array([700, 1800]))
    assert np.array_equal(found, true)


def test_what_was_not_measured_is_straight_and_what_never_was_is_none():
    time = np.array([0.0, 0.1, 0.4, 0.5, 0.0, 1.0])
    values = np.stack([[1.0, np.nan, 5.0, 5.0, np.nan, np.nan], np.full(6, np.nan)], axis=1)
    found = integrated(
        Reports(time, values, [slice(0, 4), slice(4, 6)], np.zeros(values.shape[1])), slice(0, 2)
    )
    np.testing.assert_allclose(found[:, 0], [0.0, 0.15, 1.2, 1.7, 0.0, 0.0])
    assert not found[:, 1].any()


def recorded(folder: Path, *effects: str, **replaced: str) -> tuple[MeasuredLog, MjcfFile]:
    """A log of the table with `effects`, and its task; replaced: texts of the model."""
    model = TABLE
    for old, new in replaced.items():
        model = model.replace(f'{old}="{MODELLED[old]}"', f'{old}="{new}"')
    (folder / "model.xml").write_text(model)
    (folder / "task.toml").write_text(TASK)
    log = record_log(folder, folder / "task.toml", *effects, noise=1e-3, episodes=3, duration=4.0, seed=3)
    return log, load_task(str(folder / "task.toml"))


@pytest.fixture(autouse=True)
def few_candidates(monkeypatch):
    """What it could be taken for."""
    others = (
        "sensor-bias",
        "sensor-drift",
        "sensor-scale",
        "sensor-low-pass",
        "sensor-delay",
        "constant-force",
        "payload",
    )
    look_among(monkeypatch, "sensor-high-pass", *others)


def rate_found(log: MeasuredLog, task: MjcfFile) -> float:
    """The rate of the one effect that the model lacks, which explains the log."""
    document = diagnose(log, task, seed=0)
    assert [f"{e['name']}@{e['site']}" for e in document["effects"]] == [EFFECT]
    before, after = (document[when]["test"]["normalized"] for when in ("before", "after"))
    assert after < 1.2 < 2 < before
    return document["effects"][0]["parameters"]["rate"]["value"]


def test_it_is_found_where_it_is_planted_in_windows_shorter_than_it_takes(tmp_path):
    assert rate_found(*recorded(tmp_path, f"{EFFECT}.rate={RATE}")) == pytest.approx(RATE, rel=0.01)


def test_a_sensor_that_was_on_long_before_the_log_began_had_forgotten_the_weight(tmp_path):
    log, task = recorded(tmp_path, gravity="0 0 -9.81", axis="0 0 1")
    cell = slice(log.output_names.index("cell_x"), log.output_names.index("cell_z") + 1)
    outputs, generator = log.outputs.copy(), np.random.default_rng(0)
    for steps in log.episodes:
        coupled = high_passed(log.outputs[steps, cell], rate=RATE, timestep=1 / 250, held=WEIGHT)
        outputs[steps, cell] = coupled + 0.05 * generator.standard_normal(coupled.shape)
    assert rate_found(replace(log, outputs=outputs), task) == pytest.approx(RATE, rel=0.03)
