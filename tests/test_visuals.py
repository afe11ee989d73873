"""What is only looked at, of which models of real robots are full: it is not simulated, and is there in an export."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from capture_cli.model.fields import ModelFields
from capture_cli.model.mjcf.mjcf_writer import to_mjcf
from capture_cli.model.mjcf.model_file import compile_file
from capture_cli.model.target_names import parse_target

BALL = 'type="sphere" size="0.05"'
ROBOT = """
<mujoco>
  <asset>
    <mesh name="shell" vertex="{vertices}"/>
    <texture name="paint" type="2d" builtin="flat" width="64" height="64"/>
    <material name="paint" texture="paint"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="arm" pos="0 0 0.4">
      <joint name="turn" axis="0 1 0" damping="0.1"/>
      <geom type="mesh" mesh="shell" contype="0" conaffinity="0" material="paint" density="5"/>
      <geom name="pad" {ball} pos="0.3 0 0" friction="0.7 0.005 0.0001"/>
      <geom name="cap" {ball} pos="0.1 0 0" contype="0" conaffinity="0"/>
      <geom name="tip" {ball} pos="0.5 0 0"/>
      <site name="eye" pos="0.6 0 0"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="turn"/></actuator>
  <sensor><jointpos name="angle" joint="turn"/>{sensor}</sensor>
</mujoco>
"""


def robot(folder: Path, old: str = "", new: str = "", sensor: str = "") -> Path:
    points = np.random.default_rng(0).normal(size=(3000, 3)).round(4) / 10
    text = ROBOT.format(vertices=" ".join(map(str, points.ravel())), ball=BALL, sensor=sensor)
    path = folder / "robot.xml"
    path.write_text(text.replace(old, new, 1) if old else text)
    return path


def names(model: mujoco.MjModel) -> list[str]:
    return [model.geom(g).name for g in range(model.ngeom)]


def swung(model: mujoco.MjModel) -> np.ndarray:
    """The angle (step,) as the arm falls onto the floor."""
    data, found, touched = mujoco.MjData(model), [], 0
    for _ in range(1000):
        mujoco.mj_step(model, data)
        found.append(data.qpos[0])
        touched += data.ncon
    assert touched
    return np.array(found)


def test_what_is_only_looked_at_is_left_out_and_all_moves_the_same(tmp_path):
    path = robot(tmp_path)
    lean, whole = compile_file(path), mujoco.MjModel.from_xml_path(str(path))
    assert names(lean) == ["floor", "pad", "tip"]
    assert lean.nmesh == lean.ntex == 0
    assert mujoco.mj_sizeModel(lean) < mujoco.mj_sizeModel(whole) / 5
    np.testing.assert_allclose(lean.body_inertia, whole.body_inertia, rtol=1e-12)
    np.testing.assert_allclose(swung(lean), swung(whole), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "sensor"),
    [
        ("", "", '<rangefinder name="distance" site="eye"/>'),
        ('size="1 1 1"/>', 'size="1 1 1" contype="0" conaffinity="0"/>', ""),
        ('material="paint"', 'material="paint" fluidshape="ellipsoid"', ""),
    ],
)
def test_what_a_sensor_sees_or_a_medium_flows_around_stays(tmp_path, old, new, sensor):
    assert len(names(compile_file(robot(tmp_path, old, new, sensor)))) == 5


def test_a_model_without_assets_is_as_it_is(tmp_path):
    path = tmp_path / "plain.xml"
    path.write_text(f"<mujoco><worldbody><body><joint/><geom {BALL}/>"
                    f'<geom {BALL} contype="0" conaffinity="0"/></body></worldbody></mujoco>')  # fmt: skip
    assert compile_file(path).ngeom == 2


def test_exported_it_has_all_again_and_each_geom_its_own_value(tmp_path):
    path = robot(tmp_path)
    model = compile_file(path)
    fields = ModelFields(model, 1)
    for text, value in (("geom:pad:friction", 0.31), ("geom:tip:friction", 0.52), ("body:arm:mass", 2.5)):
        parse_target(text, model, "").write(fields, np.array([value]))
    out = tmp_path / "out.xml"
    out.write_text(to_mjcf(path, fields, out))
    written = mujoco.MjModel.from_xml_path(str(out))
    assert names(written) == ["floor", "", "pad", "cap", "tip"]
    assert written.nmesh == written.ntex == 1
    assert written.body("arm").mass == 2.5
    sliding = {name: written.geom(name).friction[0] for name in ("floor", "pad", "cap", "tip")}
    assert sliding == {"floor": 1.0, "pad": 0.31, "cap": 1.0, "tip": 0.52}
