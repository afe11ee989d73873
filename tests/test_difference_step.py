"""Finite differences are as long as contacts need them, and no longer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import MACHINES as BENCHMARKS
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.base import Best
from capture_cli.estimate.solve.intervals import intervals, unit_covariance
from capture_cli.estimate.solve.linearization import SETTINGS as LINEARIZATION
from capture_cli.estimate.solve.linearization import Linearization
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks import load_task
from capture_cli.stages.identify import identify
from capture_cli.stages.record import record

TRAY_XML = """
<mujoco model="tray">
  <option timestep="0.001" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <worldbody>
    <body name="tray">
      <joint name="tray" type="slide" axis="1 0 0" damping="10"/>
      <geom name="tray" type="box" size=".5 .4 .01" pos="0 0 -.01" mass="2.5" friction=".3 .001 .0001"/>
    </body>
    <body name="box" pos="0 0 .0299">
      <freejoint name="box"/>
      <geom name="box" type="box" size=".05 .04 .03" mass=".4" friction="{friction} .001 .0001"/>
    </body>
  </worldbody>
  <actuator><position name="drive" joint="tray" kp="2500" kv="90" ctrlrange="-.05 .05"/></actuator>
  <sensor><jointpos name="tray" joint="tray"/><framepos name="box" objtype="xbody" objname="box"/></sensor>
</mujoco>
"""
TRAY_TOML = """
format = 1
name = "tray"
model = "model.xml"
parameters.friction = {{ set = ["geom:box:friction", "geom:tray:friction"], low = {low}, high = 0.8, unit = "1" }}
parameters.mass = {{ set = "body:tray:mass", low = 1.5, high = 6.0, unit = "kg", nominal = {mass} }}
inputs.drive = {{ column = "u", unit = "m" }}
outputs.tray = {{ column = "q", unit = "m" }}
outputs.box = {{ column = ["x", "y", "z"], unit = "m" }}
log.window = 1.0
"""


def tray(folder: Path, mass: float) -> Path:
    """The task.toml of a tray that shakes a box; friction 0.3 and a tray of `mass` kg where it begins."""
    folder.mkdir()
    (folder / "model.xml").write_text(TRAY_XML.format(friction=0.3))
    (folder / "task.toml").write_text(TRAY_TOML.format(low=0.1, mass=mass))
    return folder / "task.toml"


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    """Of a tray of 3.1 kg."""
    folder = tmp_path_factory.mktemp("tray")
    out = folder / "log.zarr"
    record(
        task=str(tray(folder / "true", 3.1)), out=out, noise=3e-4, episodes=2, duration=2.0, rate=100, seed=1
    )
    return out


def prepared(log: Path, task: Path):
    return prepare(MeasuredLog.read(log), load_task(str(task)))


def test_a_box_that_rocks_on_a_tray_needs_long_differences(log, tmp_path):
    assert prepared(log, tray(tmp_path / "tray", 3.1)).difference_step == pytest.approx(5e-2)


def test_without_contacts_they_stay_short(tmp_path, slider_task):
    out = tmp_path / "slider.zarr"
    record(
        task=str(slider_task),
        out=out,
        noise=1e-4,
        episodes=2,
        duration=2.0,
        rate=100,
        amplitude={"drive": 2.0},
    )
    assert prepared(out, slider_task).difference_step == 0.0


def test_a_task_may_say_its_own_for_when_bodies_hit():
    log = MeasuredLog.read(Path(__file__).resolve().parents[1] / "datasets" / "air_hockey.zarr")
    ready = prepare(log, load_task("air-hockey"))
    assert ready.difference_step == ready.task.space.steps.max() > 1e-2


def test_parameters_are_found_through_contacts(log, tmp_path):
    ready = prepared(log, tray(tmp_path / "tray", 2.2))
    found = ModelFits(ready, threads=1).fit(ready, [], ready.task.space.nominal)
    assert found.point == pytest.approx([0.3, 3.1], abs=0.05)
    assert found.error < 1.2


STOPS_XML = """
<mujoco model="stops">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="cart">
      <joint name="x" type="slide" axis="1 0 0" damping="2" limited="true" range="-.15 .15" solreflimit="0.01 .3"/>
      <geom type="box" size=".1 .1 .1" mass="2" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><motor name="m" joint="x" gear="4" ctrlrange="-5 5"/></actuator>
  <sensor><jointpos name="x" joint="x"/></sensor>
</mujoco>
"""
STOPS_TOML = """
format = 1
name = "stops"
model = "model.xml"
parameters.mass = { set = "body:cart:mass", low = 0.5, high = 5.0, unit = "kg" }
parameters.damping = { set = "joint:x:damping", low = 0.0, high = 20.0, unit = "N s/m" }
inputs.m = { column = "u", unit = "1" }
outputs.x = { column = "x", unit = "m" }
log.window = 0.5
"""


JOINT_STOPS = 'limited="true" range="-.15 .15" solreflimit="0.01 .3"'
TENDON_STOPS = f'<tendon><fixed name="rope" {JOINT_STOPS}><joint joint="x" coef="1"/></fixed></tendon>'


STOPS = {"mass": 1.3, "damping": 5.0}


def stopped(folder: Path, xml: str) -> tuple[Path, Path]:
    """The task.toml of a machine that hits its stops, and a log of it at STOPS."""
    (folder / "model.xml").write_text(xml)
    (folder / "task.toml").write_text(STOPS_TOML)
    task, out = folder / "task.toml", folder / "log.zarr"
    record(task=str(task), out=out, parameters=STOPS, noise=2e-4, episodes=3, duration=2.0, rate=125, seed=2)
    return task, out


def test_the_ends_of_a_tendon_are_stops_too(tmp_path):
    """What follows for parameters is as below."""
    xml = STOPS_XML.replace(JOINT_STOPS, "").replace("</worldbody>", "</worldbody>" + TENDON_STOPS)
    task, out = stopped(tmp_path, xml)
    assert prepared(out, task).difference_step == pytest.approx(5e-2)


def test_parameters_are_found_where_a_machine_hits_its_stops(tmp_path, monkeypatch):
    """With the slope of a bump for a derivative the mass was 0.27 kg off, at 47 noise floors."""
    monkeypatch.setattr("capture_cli.stages.identify._write_pages", lambda *_: None)
    task, out = stopped(tmp_path, STOPS_XML)
    assert prepared(out, task).difference_step == pytest.approx(5e-2)
    found = identify(
        real_log=out, task=str(task), out=tmp_path / "estimate", starts=1, quiet=True, threads=1
    ).document
    values = {name: p["value"] for name, p in found["parameters"].items()}
    assert values == pytest.approx(STOPS, rel=0.03)
    assert found["error"]["fit"]["normalized"] < 5


def pucks(folder: Path, seed: int) -> PreparedLog:
    """Sliding pucks with a friction of 0.12, of which few hit a wall."""
    task = BENCHMARKS / "puck" / "task.toml"
    velocities = {"x": (-2.0, 2.0), "y": (-2.0, 2.0)}
    record(
        task=str(task),
        out=folder / "log.zarr",
        parameters={"friction": 0.12},
        noise=5e-4,
        episodes=6,
        duration=2.0,
        rate=250,
        start_velocity=velocities,
        seed=seed,
    )
    return prepared(folder / "log.zarr", task)


def test_an_interval_is_not_narrow_for_a_window_that_jumps(tmp_path):
    """Its slope over a step that is too short, squared, counted for more than all the others together."""
    ready = pucks(tmp_path, seed=3)

    def sd(step: float) -> float:
        covariance, _ = unit_covariance(linearized(replace(ready, difference_step=step), 0.12))
        return float(np.sqrt(covariance[0, 0]))

    assert sd(0.0) < 0.7 * sd(5e-2)
    assert sd(ready.difference_step) == pytest.approx(sd(5e-2), rel=0.1)


def test_where_contacts_stop_a_descent_the_way_left_to_go_is_in_the_interval(tmp_path):
    ready = pucks(tmp_path, seed=3)
    at, space = linearized(ready, 0.13), ready.task.space
    hessian, gradient = at.normal(at.inflation)
    short_of = np.abs(gradient / (hessian[0] + at.inflation / LINEARIZATION.insensitive**2))
    assert intervals(at).sd[0] == pytest.approx(
        space.span[0] * np.hypot(np.sqrt(unit_covariance(at)[0][0, 0]), short_of[0])
    )
    smooth = linearized(replace(ready, difference_step=0.0), 0.13)
    assert smooth.inflation > 2, "far from noise, where descents end early on purpose"
    assert intervals(smooth).sd[0] == pytest.approx(space.span[0] * np.sqrt(unit_covariance(smooth)[0][0, 0]))


def linearized(ready: PreparedLog, friction: float) -> Linearization:
    """With the initial states as they were measured."""
    best = Best(np.array([friction]), np.zeros_like(ready.initial.sd), error=0.0)
    return ModelFits(ready, threads=1).at(ready, [], best).at
