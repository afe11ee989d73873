"""A robot that balances on wheels: where they touch the floor, a step of everything at once is refused."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from capture_cli.stages.identify import identify
from capture_cli.stages.import_log import import_log

MODEL = """
<mujoco model="balancer">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="10 10 .1"/>
    <body name="chassis" pos="0 0 0.05">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <joint name="pitch" type="hinge" axis="0 1 0"/>
      <geom type="box" size="0.03 0.06 0.08" pos="0 0 0.09" mass="0.9" contype="0" conaffinity="0"/>
      <site name="imu" pos="0 0 0.1"/>
      <body name="wheels">
        <joint name="axle" type="hinge" axis="0 1 0" damping="0.004"/>
        <geom type="cylinder" size="0.05 0.08" euler="90 0 0" mass="0.2"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="wheels" joint="axle" ctrlrange="-1 1"/></actuator>
  <sensor>
    <jointpos name="pitch" joint="pitch"/><jointpos name="axle" joint="axle"/><gyro name="gyro" site="imu"/>
  </sensor>
</mujoco>
"""
TASK = """
format = 1
model = "model.xml"

[parameters.mass]
set = "body:chassis:mass"
low = 0.5
high = 2.0
unit = "kg"

[parameters.com]
set = "body:chassis:com_z"
low = 0.05
high = 0.15
unit = "m"

[inputs.wheels]
column = "torque"
unit = "N m"

[outputs.pitch]
column = "pitch"
unit = "rad"

[outputs.axle]
column = "axle"
unit = "rad"

[outputs.gyro]
column = ["gx", "gy", "gz"]
unit = "rad/s"

[log]
time = "t"
window = 0.3
"""
MASS, COM = 1.1, 0.105
NOISE = np.array([9e-4, 1.7e-3, 5e-3, 5e-3, 5e-3])


def balanced(file: Path, seed: int, seconds: float) -> Path:
    """A recording of the robot while its controller keeps it upright, as a CSV."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    chassis = model.body("chassis").id
    model.body_inertia[chassis] *= MASS / model.body_mass[chassis]
    model.body_mass[chassis], model.body_ipos[chassis, 2] = MASS, COM
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    data.qpos[2] = 0.03
    generator = np.random.default_rng(seed)
    frequency, phase = generator.uniform(0.2, 2.5, 6), generator.uniform(0, 2 * np.pi, 6)
    rows = []
    for step in range(round(seconds * 1000)):
        if step % 5 == 0:
            mujoco.mj_forward(model, data)
            moved = 0.03 * np.sin(2 * np.pi * frequency * 1e-3 * step + phase).sum()
            data.ctrl[0] = np.clip(data.qpos[2:4] @ (3, 0.012) + data.qvel[2:4] @ (0.35, 0.02) + moved, -1, 1)
            rows.append(
                [1e-3 * step, data.ctrl[0], *(data.sensordata + NOISE * generator.standard_normal(5))]
            )
        mujoco.mj_step(model, data)
    np.savetxt(file, rows, delimiter=",", header="t,torque,pitch,axle,gx,gy,gz", comments="", fmt="%.6f")
    return file


def test_a_descent_goes_on_from_where_windows_alone_lead(tmp_path, without_pages):
    """Nothing measures how high it stands nor how far it went. It had ended 28 standard deviations off."""
    (tmp_path / "model.xml").write_text(MODEL)
    (tmp_path / "task.toml").write_text(TASK)
    task = str(tmp_path / "task.toml")
    files = [balanced(tmp_path / f"{seed}.csv", seed, 4.0) for seed in (1, 2)]
    import_log(files=files, task=task, out=tmp_path / "log.zarr")
    document = identify(
        real_log=tmp_path / "log.zarr", task=task, out=tmp_path / "e", starts=1, threads=1, quiet=True
    ).document
    assert document["verdict"] == "explained"
    for name, truth in (("mass", MASS), ("com", COM)):
        found = document["parameters"][name]
        assert found["value"] == pytest.approx(truth, abs=4 * found["sd"])
        assert found["sd"] < 0.05 * truth
