"""A first task file for a model: every robot gets one that loads, with the columns of a log where they belong."""

from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks import ROOT
from benchmarks._planted_logs.machines import MACHINE
from capture_cli.errors import LogError, ModelError, OutputError
from capture_cli.model.tasks import load_task
from capture_cli.stages.draft_task import draft_task
from capture_cli.stages.drafting.column_names import COMMAND, EFFORT, POSITION, Wanted, matched, time_column
from capture_cli.stages.identify import identify
from capture_cli.stages.import_log import import_log
from capture_cli.stages.record import record

MACHINES = ROOT / "benchmarks" / "machines"
ARM = """
<mujoco>
  <worldbody>
    <body>
      <joint name="shoulder_pan" axis="0 0 1" damping="0.4"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
      <body pos="0.3 0 0">
        <joint name="elbow" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02"/>
        <site name="hand" pos="0.2 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="pan" joint="shoulder_pan" kp="40" kv="2"/>
    <motor name="elbow" joint="elbow"/>
  </actuator>
  <sensor>{sensors}</sensor>
</mujoco>
"""
HAND = '<framepos name="hand" objtype="site" objname="hand"/><framequat name="turned" objtype="site" objname="hand"/>'


def drafted(folder: Path, columns: str | None, sensors: str = "") -> dict:
    """The document of the draft for the arm, by the columns of a log."""
    (folder / "arm.xml").write_text(ARM.format(sensors=sensors))
    log = None
    if columns is not None:
        log = folder / "run.csv"
        log.write_text(columns + "\n" + ",".join("0" for _ in columns.split(",")) + "\n")
    draft = draft_task(model=folder / "arm.xml", out=folder / "task.toml", log=log)
    load_task(str(draft.task))
    return tomllib.loads(draft.task.read_text())


def columns_of(task: dict, kind: str) -> dict:
    return {name: entry["column"] for name, entry in task.get(kind, {}).items()}


def test_columns_go_where_their_names_say(tmp_path):
    task = drafted(
        tmp_path, "t_us,shoulder_pan_cmd,elbow_torque,shoulder_pan_deg,elbow_pos,elbow_vel,battery"
    )
    assert task["log"] == {"time": "t_us", "time_scale": 1e-6}
    assert columns_of(task, "inputs") == {"pan": "shoulder_pan_cmd", "elbow": "elbow_torque"}
    outputs = columns_of(task, "outputs")
    assert outputs == {
        "shoulder_pan_pos": "shoulder_pan_deg",
        "elbow_pos": "elbow_pos",
        "elbow_vel": "elbow_vel",
    }
    assert task["outputs"]["shoulder_pan_pos"]["column_unit"] == "deg"
    assert (task["inputs"]["pan"]["unit"], task["inputs"]["elbow"]["unit"]) == ("rad", "N m")


def test_a_unit_says_what_a_column_is_where_no_word_does(tmp_path):
    task = drafted(tmp_path, "ros_time,elbow_deg,elbow_deg_s,elbow_trq_mNm,shoulder_pan_deg")
    assert columns_of(task, "inputs") == {"elbow": "elbow_trq_mNm"}
    assert task["inputs"]["elbow"]["column_unit"] == "mNm"
    outputs = {"shoulder_pan_pos": "shoulder_pan_deg", "elbow_pos": "elbow_deg", "elbow_vel": "elbow_deg_s"}
    assert columns_of(task, "outputs") == outputs


def test_sensors_that_the_model_lacks_are_in_a_file_that_includes_it(tmp_path):
    task = drafted(tmp_path, "time,elbow_pos,shoulder_pan_pos")
    assert task["model"] == "arm_sensors.xml"
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "arm_sensors.xml"))
    assert [written.sensor(s).name for s in range(2)] == ["shoulder_pan_pos", "elbow_pos"]
    assert "sensor" in (tmp_path / "arm.xml").read_text()  # as it was


def test_parameters_are_those_of_joints_and_servos_within_bounds(tmp_path):
    task = drafted(tmp_path, None)
    opened = task["parameters"]
    assert set(opened) == {
        *(f"{joint}_{what}" for joint in ("shoulder_pan", "elbow") for what in ("damping", "frictionloss", "armature")),
        "pan_kp",
    }  # fmt: skip
    assert opened["shoulder_pan_damping"]["high"] >= 2.0  # five times its own
    assert opened["pan_kp"]["low"] < 40 < opened["pan_kp"]["high"]
    assert all(0 <= p["low"] < p["high"] for p in opened.values())


def test_the_gain_of_a_servo_on_a_slide_is_in_its_units(tmp_path):
    model = tmp_path / "rail.xml"
    model.write_text(
        ARM.format(sensors="").replace('name="shoulder_pan" axis', 'name="shoulder_pan" type="slide" axis')
    )
    task = tomllib.loads(draft_task(model=model, out=tmp_path / "task.toml").task.read_text())
    assert task["parameters"]["pan_kp"]["unit"] == "N/m"
    assert task["inputs"]["pan"]["unit"] == "m"


def test_axes_and_attitudes_have_a_column_each(tmp_path):
    task = drafted(tmp_path, "time,hand_x,hand_z,turned_w,turned_x,turned_y,turned_z", HAND)
    assert columns_of(task, "outputs") == {
        "hand": ["hand_x", "", "hand_z"],
        "turned": ["turned_w", "turned_x", "turned_y", "turned_z"],
    }
    assert task["model"] == "arm.xml"


def test_an_attitude_of_which_a_value_is_missing_is_left_out(tmp_path):
    task = drafted(tmp_path, "time,hand_x,turned_w,turned_x,turned_y", HAND)
    assert set(task["outputs"]) == {"hand"}
    assert "# No column of run.csv looks like: pan, elbow, turned" in (tmp_path / "task.toml").read_text()


@pytest.mark.parametrize(
    ("wanted", "columns", "found"),
    [
        # numbers have to be the same
        ([("joint1", POSITION), ("joint2", POSITION)], ["q2", "q1"], ["q1", "q2"]),
        ([("joint1", POSITION)], ["q2"], [None]),
        # what was sent is not what was measured
        ([("elbow", POSITION)], ["elbow_target"], [None]),
        ([("elbow", COMMAND)], ["elbow_measured"], [None]),
        # names of one kind of thing each, and nothing else
        ([("motor", EFFORT)], ["angle_deg", "torque_Nm"], ["torque_Nm"]),
        ([("left", EFFORT), ("right", EFFORT)], ["torque_Nm"], [None, None]),
        # one column for one channel
        ([("elbow", POSITION), ("elbow", POSITION)], ["elbow_pos"], ["elbow_pos", None]),
        ([("wristFlex", POSITION)], ["wrist_flex.pos"], ["wrist_flex.pos"]),
    ],
)
def test_names_are_compared_by_their_words(wanted, columns, found):
    assert matched([Wanted((name,), (role,)) for name, role in wanted], columns) == found


def test_the_time_is_the_column_that_says_so():
    assert time_column(["torque", "Time [s]"]) == "Time [s]"
    assert time_column(["torque", "tip"]) is None
    assert time_column(["torque", "ros_time"]) == "ros_time"
    assert time_column(["rise_time", "t"]) == "t"


@pytest.mark.parametrize("name", [*MACHINE])
def test_every_machine_gets_a_task_that_loads(tmp_path, name):
    model = shutil.copy(MACHINES / name / "model.xml", tmp_path)
    task = load_task(str(draft_task(model=Path(model), out=tmp_path / "task.toml").task))
    assert task.outputs


def test_what_was_drafted_identifies(slider_task, tmp_path):
    made = record(
        task=str(slider_task),
        out=tmp_path / "made.zarr",
        noise=1e-3,
        rate=100,
        duration=4.0,
        amplitude={"drive": 8.0},
    ).log
    log = tmp_path / "run.csv"
    values = np.column_stack([made.time, made.inputs, made.outputs])
    np.savetxt(log, values, delimiter=",", header="t_s,drive_force,q_pos", comments="")
    draft = draft_task(model=slider_task.parent / "model.xml", out=tmp_path / "task.toml", log=log)
    assert not draft.unused
    import_log(files=[log], task=str(draft.task), out=tmp_path / "log.zarr")
    found = identify(
        real_log=tmp_path / "log.zarr", task=str(draft.task), out=tmp_path / "out", threads=1, quiet=True
    )
    assert found.document["verdict"] in ("explained", "not-identifiable")


def test_wrong_files_are_refused_and_nothing_is_written(tmp_path):
    with pytest.raises(LogError, match=r"no column looks like what .* could measure") as caught:
        drafted(tmp_path, "time,battery,fan")
    assert "shoulder_pan_pos" in caught.value.cure
    bare = tmp_path / "bare.xml"
    bare.write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    with pytest.raises(ModelError, match="no sensor with a name"):
        draft_task(model=bare, out=tmp_path / "task.toml")
    with pytest.raises(OutputError, match="is named as"):
        draft_task(model=tmp_path / "arm.xml", out=tmp_path / "task.json")
    assert not (tmp_path / "task.toml").exists() and not list(tmp_path.glob("*_sensors.xml"))


def test_nothing_is_replaced_unasked(tmp_path):
    drafted(tmp_path, None)
    (tmp_path / "task.toml").unlink()
    with pytest.raises(OutputError, match=r"arm_sensors.xml exists"):
        drafted(tmp_path, None)


def test_the_command_says_what_it_wrote(capture, tmp_path):
    (tmp_path / "arm.xml").write_text(ARM.format(sensors=""))
    _, said, _ = capture("draft-task", tmp_path / "arm.xml", "--out", tmp_path / "task.toml")
    assert "7 parameters, 4 channels" in said and "arm_sensors.xml" in said and "import-log" in said
    _, out, _ = capture("draft-task", tmp_path / "arm.xml", "--out", tmp_path / "b.toml", "--force", "--json")
    assert json.loads(out)["columns"]["elbow_pos"] == ["elbow_pos"]


def test_without_a_log_each_value_has_a_column_of_its_own(tmp_path):
    task = drafted(tmp_path, None, HAND)
    assert columns_of(task, "outputs")["turned"] == ["turned_w", "turned_x", "turned_y", "turned_z"]
    assert columns_of(task, "outputs")["hand"] == ["hand_x", "hand_y", "hand_z"]
