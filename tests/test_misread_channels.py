"""A wrong sign or unit of a channel is named; a model that lacks something is not mistaken for one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from capture_cli.protocol.misread_channels import FACTORS, Misread, Reading, _groups, misread_channels
from capture_cli.protocol.prepare import prepare
from capture_cli.sim.engine import Engine
from capture_cli.stages import identify as stage
from capture_cli.stages.inspect import inspect
from capture_cli.stages.record import record
from capture_cli.stores import output
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.tasks import load_task

MACHINES = Path(__file__).resolve().parents[1] / "benchmarks" / "machines"
NOISE = {"slider": 5e-4, "arm": 1e-3}


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> dict[str, MeasuredLog]:
    folder = tmp_path_factory.mktemp("logs")
    made = {}
    for machine, noise in NOISE.items():
        path = folder / f"{machine}.zarr"
        options = dict(random_parameters=True, noise=noise, episodes=4, duration=1.5, rate=100.0, seed=1)
        made[machine] = replace(record(task=task(machine), out=path, threads=1, **options).log, path=path)
    return made


def task(machine: str) -> str:
    return str(MACHINES / machine / "task.toml")


def misread(log: MeasuredLog, machine: str) -> Misread | None:
    prepared = prepare(log, load_task(task(machine)), window=None, test=None, seed=0, threads=1)
    found, _ = misread_channels(prepared, None, 1, lambda done, total: None)
    return found


def multiplied(log: MeasuredLog, kind: str, channels: list[int], factor: float) -> MeasuredLog:
    values = getattr(log, kind).copy()
    values[:, channels] *= factor
    return replace(log, **{kind: values})


@pytest.mark.parametrize("factor", [-1.0, 1e-3, np.pi / 180])
def test_an_output_of_another_sign_or_unit_is_named(logs, factor):
    log = multiplied(logs["slider"], "outputs", [0], 1 / factor)
    found = misread(log, "slider")
    assert Reading("outputs", (log.output_names[0],), factor) in found.readings
    assert found.after < 0.1 < found.before
    assert FACTORS[factor] in found.text


@pytest.mark.parametrize(
    ("kind", "channels", "factor"),
    [("inputs", [0], -1.0), ("outputs", [1], -1.0), ("outputs", [0, 1], np.pi / 180)],
)
def test_of_two_joints_the_one_or_both_are_named(logs, kind, channels, factor):
    log = logs["arm"]
    names = log.input_names if kind == "inputs" else log.output_names
    found = misread(multiplied(log, kind, channels, 1 / factor), "arm")
    assert found.readings == (Reading(kind, tuple(names[k] for k in channels), factor),)


@pytest.mark.parametrize("machine", NOISE)
def test_of_a_log_that_was_read_rightly_nothing_is_named(logs, machine):
    assert misread(logs[machine], machine) is None


def test_a_model_that_lacks_much_has_no_misread_channel(tmp_path):
    effects = ["coulomb-friction@x=25.0", "control-delay@drive=0.08"]
    log = record(
        task=task("slider"),
        out=tmp_path / "log.zarr",
        effects=effects,
        noise=5e-4,
        episodes=4,
        duration=1.5,
        rate=100.0,
        threads=1,
    ).log
    assert misread(replace(log, path=tmp_path / "log.zarr"), "slider") is None


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
    groups = list(_groups(SimpleNamespace(task=load_task(str(tmp_path / "task.toml")))))
    assert [names for _, names in groups] == [("w_x",), ("w_y",), ("w_z",), ("w_x", "w_y", "w_z")]


@pytest.fixture
def simulated(monkeypatch) -> list[int]:
    """How many windows of the log simulators have been asked for, each time."""
    counts = []
    own = Engine.rollout

    def counted(engine, **asked):
        before = engine.rollouts
        done = own(engine, **asked)
        counts.append(engine.rollouts - before)
        return done

    monkeypatch.setattr(Engine, "rollout", counted)
    return counts


def test_what_was_simulated_to_see_it_is_counted(logs, simulated):
    prepared = prepare(logs["slider"], load_task(task("slider")), window=None, test=None, seed=0, threads=1)
    simulated.clear()
    _, rollouts = misread_channels(prepared, None, 1, lambda done, total: None)
    assert rollouts == sum(simulated) > 0


def test_identify_says_it_and_does_not_ask_for_a_diagnosis(logs, tmp_path, monkeypatch, simulated):
    monkeypatch.setattr(stage, "_write_pages", lambda *_: None)
    monkeypatch.setattr(output, "_sync", lambda _: None)
    log = multiplied(logs["slider"], "outputs", [0], -1.0)
    log.write(tmp_path / "log.zarr")
    found = stage.identify(
        real_log=tmp_path / "log.zarr", task=task("slider"), out=tmp_path / "estimate", threads=1, quiet=True
    ).document
    assert {"kind": "outputs", "channels": ("q",), "factor": -1.0} in found["misread"]["readings"]
    assert found["next_command"] is None
    assert found["rollouts"]["simulated"] == sum(simulated)
    assert "misread" in found["summary"]
    (verdict,) = (f for f in inspect(tmp_path / "estimate", None)["findings"] if f["where"] == "verdict")
    assert verdict["cure"] == found["misread"]["text"]
