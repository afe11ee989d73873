"""A machine whose attitude is measured, for tests of logs with quaternions."""

from __future__ import annotations

from pathlib import Path

GIMBAL = """
<mujoco>
  <option timestep="0.004" gravity="0 0 0"/>
  <worldbody><body>
    <joint name="gimbal" type="ball" damping="0.02" stiffness="0.2"/><geom type="box" size=".1 .08 .05" mass="2"/>
  </body></worldbody>
  <actuator><motor name="roll" joint="gimbal" gear="1 0 0" ctrllimited="true" ctrlrange="-1 1"/></actuator>
  <sensor><ballquat name="attitude" joint="gimbal"/></sensor>
</mujoco>
"""
GIMBAL_TASK = """
format = 1
name = "gimbal"
model = "model.xml"
parameters.damping = { set = "joint:gimbal:damping", low = 0.0, high = 0.1, unit = "N m s/rad" }
inputs.roll = { column = "roll", unit = "N m" }
outputs.attitude = { column = ["w", "x", "y", "z"], unit = "1" }
log = { time = "t", window = 0.5 }
"""


def gimbal(folder: Path) -> Path:
    """The task.toml of a ball joint that is rolled, written into `folder` with its model."""
    (folder / "model.xml").write_text(GIMBAL)
    (folder / "task.toml").write_text(GIMBAL_TASK)
    return folder / "task.toml"
