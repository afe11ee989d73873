"""A wrong sign or unit of a channel is named; a model that lacks something is not mistaken for one."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from held_inputs import held_machine
from inspecting import inspect

from capture_cli.estimate.misread_channels import (
    FACTORS,
    Misread,
    Reading,
    _exchanged,
    _exchanges,
    _groups,
    _orders,
    _values,
    misread_channels,
)
from capture_cli.estimate.misread_channels import SETTINGS as MISREAD_CHANNELS
from capture_cli.estimate.prepare import prepare
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.base import Channel
from capture_cli.report.findings import suspicions
from capture_cli.simulate.engine import Engine
from capture_cli.stages import identify as stage
from capture_cli.stages.record import record
from capture_cli.stages.recorded.recorded_estimate import DiagnosedEstimate

NOISE = {"slider": 5e-4, "arm": 1e-3}


@pytest.fixture(scope="module")
def tasks(tmp_path_factory) -> dict[str, str]:
    """Of the machines, whose models take the steps that the logs have."""
    folder = tmp_path_factory.mktemp("tasks")
    return {machine: str(held_machine(folder / machine, machine, 0.01)) for machine in NOISE}


@pytest.fixture(scope="module")
def logs(tmp_path_factory, tasks) -> dict[str, MeasuredLog]:
    folder = tmp_path_factory.mktemp("logs")
    made = {}
    for machine, noise in NOISE.items():
        path = folder / f"{machine}.zarr"
        options = dict(random_parameters=True, noise=noise, episodes=4, duration=1.5, rate=100.0, seed=1)
        made[machine] = replace(record(task=tasks[machine], out=path, threads=1, **options).log, path=path)
    return made


def misread(log: MeasuredLog, task: str) -> Misread | None:
    prepared = prepare(log, load_task(task), threads=1)
    found, _ = misread_channels(prepared, None, 1, lambda done, total: None)
    return found


def multiplied(log: MeasuredLog, kind: str, channels: list[int], factor: float) -> MeasuredLog:
    values = getattr(log, kind).copy()
    values[:, channels] *= factor
    return replace(log, **{kind: values})


@pytest.mark.parametrize("factor", [-1.0, 1e-3, np.pi / 180])
def test_an_output_of_another_sign_or_unit_is_named(tasks, logs, factor):
    log = multiplied(logs["slider"], "outputs", [0], 1 / factor)
    found = misread(log, tasks["slider"])
    assert Reading("outputs", (log.output_names[0],), factor) in found.readings
    assert found.after < 0.1 < found.before
    text = found.text(load_task(tasks["slider"]))
    assert FACTORS[factor] in text
    assert re.search(r"Write `scale = -?[\d.e-]+` below \[(in|out)puts\.\w+\] in the task file", text)


@pytest.mark.parametrize(
    ("kind", "channels", "factor"),
    [("inputs", [0], -1.0), ("outputs", [0, 1], np.pi / 180)],
)
def test_of_two_joints_the_one_or_both_are_named(tasks, logs, kind, channels, factor):
    log = logs["arm"]
    names = log.input_names if kind == "inputs" else log.output_names
    found = misread(multiplied(log, kind, channels, 1 / factor), tasks["arm"])
    assert found.readings == (Reading(kind, tuple(names[k] for k in channels), factor),)


@pytest.mark.parametrize("machine", NOISE)
def test_of_a_log_that_was_read_rightly_nothing_is_named(tasks, logs, machine):
    assert misread(logs[machine], tasks[machine]) is None


def test_a_model_that_lacks_much_has_no_misread_channel(tasks, tmp_path):
    effects = ["coulomb-friction@x=25.0", "control-delay@drive=0.08"]
    log = record(
        task=tasks["slider"],
        out=tmp_path / "log.zarr",
        effects=effects,
        noise=5e-4,
        episodes=4,
        duration=1.5,
        rate=100.0,
        threads=1,
    ).log
    assert misread(replace(log, path=tmp_path / "log.zarr"), tasks["slider"]) is None


def test_an_attitude_is_read_as_it_is(tmp_path):
    """Its four numbers are of one length, whatever the unit."""
    (tmp_path / "model.xml").write_text(
        '<mujoco><worldbody><body><joint name="b" type="ball"/><geom size=".1"/><site name="s"/></body></worldbody>'
        '<sensor><ballquat name="turn" joint="b"/><gyro name="w" site="s"/></sensor></mujoco>'
    )
    (tmp_path / "task.toml").write_text(
        'format = 1\nname = "top"\nmodel = "model.xml"\n'
        '[outputs.turn]\ncolumn = ["a", "b", "c", "d"]\nunit = "1"\n'
        '[outputs.w]\ncolumn = ["x", "y", "z"]\nunit = "rad/s"\n'
    )
    task = load_task(str(tmp_path / "task.toml"))
    groups = list(_groups(task))
    assert [names for _, names in groups] == [("w_x",), ("w_y",), ("w_z",), ("w_x", "w_y", "w_z")]
    left = np.array([9.0, 9.0, 9.0, 9.0, 0.1, 0.3, np.nan])
    exchanged = [way.channels for way in _exchanges(task, left)]
    assert exchanged == [("w_x", "w_y"), ("w_y", "w_z"), ("w_x", "w_z")]


def write_boat(folder: Path, columns: str) -> Path:
    """A free body that a thruster turns, with its attitude from four columns; the path of its task."""
    (folder / "model.xml").write_text(
        '<mujoco><option gravity="0 0 0" timestep=".005"/><worldbody><body name="b"><freejoint/>'
        '<geom type="box" size=".3 .1 .05" mass="2"/><site name="s"/></body></worldbody>'
        '<actuator><motor name="turn" site="s" gear="0 0 0 .3 1 2" ctrlrange="-.3 .3"/></actuator>'
        '<sensor><framequat name="quat" objtype="site" objname="s"/>'
        '<framepos name="pos" objtype="site" objname="s"/></sensor></mujoco>'
    )
    quoted = ", ".join(f'"{c}"' for c in columns.split())
    (folder / "task.toml").write_text(
        'format = 1\nname = "boat"\nmodel = "model.xml"\n'
        '[parameters.gear]\nset = "actuator:turn:gain"\nlow = 0.5\nhigh = 2.0\nunit = "1"\n'
        '[inputs.turn]\ncolumn = "u"\nunit = "N m"\n'
        f'[outputs.quat]\ncolumn = [{quoted}]\nunit = "1"\n'
        '[outputs.pos]\ncolumn = ["px", "py", "pz"]\nunit = "m"\n[log]\nwindow = 0.5\n'
    )
    return folder / "task.toml"


def test_of_two_channels_with_each_other_s_columns_both_are_named(tasks, logs):
    log, channels = logs["arm"], load_task(tasks["arm"]).inputs
    found = misread(replace(log, inputs=log.inputs[:, ::-1].copy()), tasks["arm"])
    names, columns = (tuple(getattr(c, key) for c in channels) for key in ("name", "column"))
    assert Reading("inputs", names, columns=columns[::-1]) in found.readings
    assert f"{names[0]} from {columns[1]!r}, {names[1]} from {columns[0]!r}" in found.text(
        load_task(tasks["arm"])
    )
    assert found.after < 0.1 < found.before


def test_a_column_of_another_scale_is_read_as_its_channel_says():
    one = Channel("one", "rad", "a", 0, scale=0.1, offset=2.0)
    other = Channel("other", "rad", "b", 1, scale=-1.0)
    (way,) = _exchanged("outputs", [{"": one}, {"": other}], {})
    columns = np.array([[5.0, 7.0], [6.0, 8.0]])  # a, b
    read = _values((one, other), columns * [0.1, -1.0] + [2.0, 0.0], way)
    assert read == pytest.approx(columns[:, ::-1] * [0.1, -1.0] + [2.0, 0.0])


def test_channels_are_exchanged_that_say_the_same_and_not_too_many():
    many = [{"": Channel(f"q{k}", "rad", f"c{k}", k)} for k in range(20)]
    error = {"q3": 2.0, "q7": 1.0}
    ways = list(_exchanged("outputs", many, error))
    assert len(ways) == MISREAD_CHANNELS.most_pairs
    assert ways[0] == Reading("outputs", ("q3", "q7"), columns=("c7", "c3"))
    others = [
        Channel("w", "rad/s", "c", 0),
        Channel("s", "rad", "d", 1, sparse=True),
        Channel("q", "rad", "c0", 2),
    ]
    assert list(_exchanged("outputs", [many[0], *({"": c} for c in others)], {})) == []


def recorded(path: Path, **options) -> MeasuredLog:
    """A log of the machine at `path`, of random parameters."""
    made = record(
        task=str(path), out=path.parent / "log.zarr", random_parameters=True, threads=1, seed=1, **options
    )
    return replace(made.log, path=path.parent / "log.zarr")


def test_joints_of_which_all_is_exchanged(tasks, tmp_path):
    """A message of joint states has one order for all that it says of them."""
    model = Path(tasks["arm"]).with_name("model.xml").read_text()
    speeds = '<jointvel name="w1" joint="shoulder"/><jointvel name="w2" joint="elbow"/></sensor>'
    (tmp_path / "model.xml").write_text(model.replace("</sensor>", speeds))
    outputs = "".join(f'[outputs.w{k}]\ncolumn = "w{k}"\nunit = "rad/s"\n' for k in (1, 2))
    (tmp_path / "task.toml").write_text(Path(tasks["arm"]).read_text().replace("[log]", f"{outputs}[log]"))
    log = recorded(tmp_path / "task.toml", noise=1e-3, episodes=2, duration=1.5, rate=100.0)
    found = misread(replace(log, outputs=log.outputs[:, [1, 0, 3, 2]]), str(tmp_path / "task.toml"))
    (way,) = found.readings
    assert dict(zip(way.channels, way.columns, strict=True)) == {
        "q1": "q2_rad",
        "q2": "q1_rad",
        "w1": "w2",
        "w2": "w1",
    }


def test_an_attitude_whose_w_is_last_is_named_before_anything_else(tmp_path):
    path = write_boat(tmp_path, "a b c d")
    log = recorded(path, noise=1e-3, episodes=2, duration=2.0, rate=50.0)
    told = []
    prepared = prepare(
        replace(log, outputs=log.outputs[:, [1, 2, 3, 0, 4, 5, 6]]),
        load_task(str(path)),
        threads=1,
    )
    found, _ = misread_channels(prepared, None, 1, lambda done, total: told.append(done))
    names = ("quat_w", "quat_x", "quat_y", "quat_z")
    assert found.readings == (Reading("outputs", names, columns=("d", "a", "b", "c")),)
    assert told == [0]


def test_the_order_that_names_say_is_tried(tmp_path):
    task = load_task(str(write_boat(tmp_path, "qz qy qx qw")))
    columns = [way.columns for way in _orders(task)]
    assert columns == [("qw", "qx", "qy", "qz"), ("qw", "qz", "qy", "qx")]


@pytest.fixture
def simulated(monkeypatch) -> list[int]:
    """How many windows of the log simulators have been asked for, each time."""
    counts = []
    own = Engine.rollout

    def counted(engine, *asked, **how):
        before = engine.rollouts
        done = own(engine, *asked, **how)
        counts.append(engine.rollouts - before)
        return done

    monkeypatch.setattr(Engine, "rollout", counted)
    return counts


def test_what_was_simulated_to_see_it_is_counted(tasks, logs, simulated):
    prepared = prepare(logs["slider"], load_task(tasks["slider"]), threads=1)
    simulated.clear()
    _, rollouts = misread_channels(prepared, None, 1, lambda done, total: None)
    assert rollouts == sum(simulated) > 0


def test_identify_says_it_and_does_not_ask_for_a_diagnosis_which_says_it_again(
    tasks, logs, tmp_path, monkeypatch, simulated, capsys
):
    monkeypatch.setattr(stage, "_write_pages", lambda *_: None)
    log = multiplied(logs["slider"], "outputs", [0], -1.0)
    log.write(tmp_path / "log.zarr")
    found = stage.identify(
        real_log=tmp_path / "log.zarr", task=tasks["slider"], out=tmp_path / "estimate", threads=1, quiet=True
    ).document
    assert {"kind": "outputs", "channels": ("q",), "factor": -1.0, "columns": None} in found["misread"][
        "readings"
    ]
    assert found["next_command"] is None
    assert found["rollouts"]["simulated"] == sum(simulated)
    assert "misread" in found["summary"]
    (verdict,) = (f for f in inspect(tmp_path / "estimate", None)["findings"] if f["where"] == "verdict")
    assert verdict["cure"] == found["misread"]["text"]
    DiagnosedEstimate.read(tmp_path / "estimate").warn_of_misread_channels()
    assert found["misread"]["text"] in capsys.readouterr().err


@pytest.mark.parametrize("driven", [True, False])
def test_where_columns_are_to_be_checked_first_no_diagnosis_is_asked_for(
    tasks, logs, tmp_path, monkeypatch, driven
):
    """A log without what drove the machine, and one whose output is a column of something else."""
    monkeypatch.setattr(stage, "_write_pages", lambda *_: None)
    log = logs["slider"]
    if driven:
        other = np.random.default_rng(0).normal(size=log.outputs.shape).cumsum(axis=0)
        log = replace(log, outputs=0.1 * other)
    else:
        log = replace(log, inputs=np.zeros_like(log.inputs))
    log.write(tmp_path / "log.zarr")
    out = tmp_path / "estimate"
    estimate = stage.identify(
        real_log=tmp_path / "log.zarr", task=tasks["slider"], out=out, starts=1, threads=1, quiet=True
    )
    document = estimate.document
    assert (document["verdict"], document["misread"]) == ("unexplained", None)
    assert document["next_command"] is None
    assert "may be misread" in document["summary"]
    said = suspicions(estimate)
    assert all("before anything else" in text for text in said)
    assert ["Input drive is 0 throughout" in text for text in said] == ([False] if driven else [True, False])
    (verdict,) = (f for f in inspect(out)["findings"] if f["where"] == "verdict")
    assert verdict["cure"].startswith("check columns, units and signs before anything else")
