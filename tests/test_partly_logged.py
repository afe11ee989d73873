"""Sensors of which some values are logged: a gyroscope about one axis, a camera that looks from above."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from diagnosing import look_among
from test_starts import GYROS

from capture_cli.errors import TaskError
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.coordinate_sources import sources_of
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.base import SeenLog
from capture_cli.model.tasks import load_task
from capture_cli.stages import diagnose as diagnose_stage
from capture_cli.stages import identify as identify_stage
from capture_cli.stages.export import export
from capture_cli.stages.import_log import import_log
from capture_cli.stages.record import record

# Pushed and turned on a level plane, with nothing below it: only x, y and the rate of turning are logged.
CRAFT = """
<mujoco model="craft">
  <option timestep="0.004" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody><body name="craft">
    <joint name="free" type="free" damping="0.4"/><geom type="box" size=".2 .12 .04" mass="4"/><site name="imu"/>
  </body></worldbody>
  <actuator>
    <motor name="push" site="imu" gear="1 0 0 0 0 0" ctrlrange="-4 4"/>
    <motor name="turn" site="imu" gear="0 0 0 0 0 1" ctrlrange="-.2 .2"/>
  </actuator>
  <sensor>
    <framepos name="where" objtype="xbody" objname="craft"/><gyro name="gyro" site="imu"/>
    <framequat name="how" objtype="xbody" objname="craft"/>
  </sensor>
</mujoco>
"""
TASK = """
format = 1
name = "craft"
model = "model.xml"
parameters.mass = { set = "body:craft:mass", low = 2.0, high = 8.0, unit = "kg" }
parameters.damping = { set = "joint:free:damping", low = 0.1, high = 1.0, unit = "N s/m" }
inputs.push = { column = "push", unit = "N", interpolate = "hold" }
inputs.turn = { column = "turn", unit = "N m", interpolate = "hold" }
outputs.where = { column = ["x_mm", "y_mm", ""], column_unit = "mm", unit = "m" }
outputs.gyro = { column = ["", "", "gz"], unit = "rad/s" }
log = { time = "t", window = 1.0 }
"""


@pytest.fixture
def craft(tmp_path) -> Path:
    (tmp_path / "craft").mkdir()
    (tmp_path / "craft" / "model.xml").write_text(CRAFT)
    (tmp_path / "craft" / "task.toml").write_text(TASK)
    return tmp_path / "craft" / "task.toml"


def recorded(task: Path, **options) -> MeasuredLog:
    noise = {"where_x": 1e-3, "where_y": 1e-3, "gyro_z": 2e-3}
    return record(
        task=str(task),
        out=task.parent / "made.zarr",
        parameters={"mass": 5.0, "damping": 0.6},
        noise=noise,
        episodes=3,
        duration=6.0,
        rate=50,
        threads=1,
        **options,
    ).log


def imported(task: Path, log: MeasuredLog) -> Path:
    """The log as one of CSV files that lack what was not logged."""
    files = []
    for number, e in enumerate(log.episodes):
        mm = log.outputs[e] * [1e3, 1e3, 1]
        table = np.column_stack([log.time[e], log.inputs[e], mm])
        files.append(task.parent / f"{number}.csv")
        np.savetxt(files[-1], table, delimiter=",", header="t,push,turn,x_mm,y_mm,gz", comments="")
    import_log(files=files, task=str(task), out=task.parent / "log.zarr")
    return task.parent / "log.zarr"


def test_what_was_not_logged_is_no_output(craft, tmp_path, monkeypatch):
    """From record and import-log through identify to export."""
    monkeypatch.setattr(identify_stage, "_write_pages", lambda *_: None)
    made = recorded(craft)
    assert made.output_names == ("where_x", "where_y", "gyro_z")
    log = imported(craft, made)
    np.testing.assert_allclose(MeasuredLog.read(log).outputs, made.outputs, atol=1e-12)
    found = identify_stage.identify(
        real_log=log, task=str(craft), out=tmp_path / "e", starts=1, threads=1, quiet=True
    )
    assert found.document["verdict"] == "explained"
    for name, true in (("mass", 5.0), ("damping", 0.6)):
        p = found.document["parameters"][name]
        assert p["value"] == pytest.approx(true, rel=0.05) and p["identifiable"], name
    exported = export(result=tmp_path / "e", out=tmp_path / "found.xml")
    assert mujoco.MjModel.from_xml_path(str(exported.model)).nsensordata == 10


def test_starts_are_read_off_the_values_that_are_logged():
    craft = mujoco.MjModel.from_xml_string(CRAFT)

    def read(*data: int) -> dict[str, tuple[int, ...]]:
        return {s.kind: s.dofs for s in sources_of(craft, data)}

    assert read(0, 1, 5) == {"position": (0, 1), "velocity": (5,)}
    assert read(2) == {"position": (2,)}
    assert read(3, 4, 5) == {"velocity": (3, 4, 5)}
    # all three velocities of a body are taken from one sensor
    assert read(5, 6, 7, 8, 9) == {"orientation": (3, 4, 5)}
    askew = mujoco.MjModel.from_xml_string(GYROS)
    assert sources_of(askew, [int(askew.sensor("own").adr[0])]) == []


@pytest.mark.parametrize(
    ("column", "words", "cure"),
    [
        ('"gz"', "the sensor has 3 values", 'column = ["", "", "gz"]'),
        ('["", "", ""]', "the sensor has 3 values", 'column = ["", "", "NAME"]'),
        ('["gz", ""]', "the sensor has 3 values", '"" for what was not logged'),
    ],
)
def test_how_to_say_that_values_were_not_logged(craft, column, words, cure):
    craft.write_text(TASK.replace('["", "", "gz"]', column))
    with pytest.raises(TaskError, match=words) as caught:
        load_task(str(craft))
    assert cure in caught.value.cure


def test_an_attitude_is_logged_whole(craft):
    craft.write_text(TASK + 'outputs.how = { column = ["w", "", "", "z"], unit = "1" }\n')
    with pytest.raises(TaskError, match="an attitude is all of its 4 values") as caught:
        load_task(str(craft))
    assert "[outputs.how]" in caught.value.message


def test_an_effect_on_a_sensor_has_the_values_alone_that_were_logged(craft, tmp_path, monkeypatch):
    look_among(monkeypatch, "sensor-bias", "sensor-drift", "sensor-scale", "constant-force", "gravity-tilt")
    monkeypatch.setattr(diagnose_stage, "_write_pages", lambda *_: None)
    log = imported(craft, recorded(craft, effects=["sensor-bias@gyro.z=0.1"]))
    options = dict(most_effects=1, starts=1, expression=False, threads=1, quiet=True)
    diagnose_stage.diagnose(real_log=log, task=str(craft), out=tmp_path / "d", **options)
    document = json.loads((tmp_path / "d" / "diagnosis.json").read_text())
    (effect,) = document["effects"]
    assert effect["name"] == "sensor-bias"
    assert list(effect["parameters"]) == ["z"]
    assert effect["parameters"]["z"]["value"] == pytest.approx(0.1, abs=2e-3)
    exported = export(result=tmp_path / "d", out=tmp_path / "found.xml")
    assert exported.companion is not None


@pytest.mark.parametrize("kind", ["sensor-bias", "sensor-drift", "sensor-crosstalk"])
def test_what_was_not_logged_is_left_as_it_is(craft, kind):
    model = load_task(str(craft)).model
    known = {"window": 1.0, "longest": 6.0, "seen": {}}
    site = next(s for s in REGISTRY.get(kind).sites(model) if s.startswith("gyro"))
    whole, partly = (REGISTRY.get(kind)(model, site) for _ in range(2))
    partly.look_in(SeenLog(logged=frozenset({0, 1, 5}), **known))
    assert [p.name for p in partly.parameters] == ["z"]
    sensors, force = np.ones((1, 4, model.nsensordata)), np.ones((1, 4, model.nu))
    values, all_of_them = np.array([[0.1]]), np.array([[0.0, 0.0, 0.1]])
    for effect, given in ((whole, all_of_them), (partly, values)):
        effect.found = effect.measure(sensors, given, 0.01, elapsed=np.zeros(1))
        if effect.reads_actuators:
            effect.found = effect.pick_up(sensors, given, force)
    np.testing.assert_array_equal(partly.found, whole.found)
    assert not np.array_equal(partly.found, sensors)
