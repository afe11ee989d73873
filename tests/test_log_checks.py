"""Whether a log can tell of what is asked."""

from __future__ import annotations

import numpy as np
import pytest

from capture_cli.common.quantities import percent
from capture_cli.errors import FitError
from capture_cli.estimate.log_requirements import check_parameters_move_outputs
from capture_cli.estimate.prepare import prepare
from capture_cli.model.tasks import load_task
from capture_cli.stages.import_log import import_log

XML = """
<mujoco model="cart">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <geom name="wall" type="box" size=".1 1 1" pos=".8 0 0"/>
    <body name="cart">
      <joint name="x" type="slide" axis="1 0 0"/>
      <geom name="box" type="box" size=".1 .1 .1" mass="2"/>
    </body>
  </worldbody>
  <actuator><motor name="m" joint="x"/></actuator>
  <sensor><jointpos name="x" joint="x"/></sensor>
</mujoco>
"""
TOML = """
format = 1
name = "cart"
model = "model.xml"
parameters.mass = { set = "body:cart:mass", low = 1.0, high = 5.0, unit = "kg" }
parameters.bounce = { set = ["geom:wall:restitution", "geom:box:restitution"], low = 0.2, high = 0.9, unit = "1" }
inputs.m = { column = "u", unit = "N" }
outputs.x = { column = "x", unit = "m" }
log.time = "t"
log.window = 0.5
"""


def driven(folder, *, bump: float):
    """A cart that sways for 20 s, and for a moment, in one window of 40, goes as far as `bump` (m) as well."""
    (folder / "model.xml").write_text(XML)
    (folder / "task.toml").write_text(TOML)
    time = np.arange(0, 20, 0.01)
    place = 0.1 * np.sin(time) + bump * np.exp(-np.square((time - 10.6) / 0.1) / 2)
    place += 1e-4 * np.random.default_rng(0).standard_normal(len(time))
    table = np.stack([time, np.sin(3 * time), place], axis=1)
    np.savetxt(folder / "log.csv", table, delimiter=",", header="t,u,x", comments="")
    task, out = str(folder / "task.toml"), folder / "log.zarr"
    log = import_log(files=[folder / "log.csv"], task=task, out=out)
    return prepare(log, load_task(task))


def test_what_shows_in_one_window_alone_moves_outputs(tmp_path):
    assert check_parameters_move_outputs(driven(tmp_path, bump=0.4), seed=0, threads=1) > 0


def test_what_shows_in_none_is_named(tmp_path):
    with pytest.raises(FitError, match="'cart': bounce moves no output of this log"):
        check_parameters_move_outputs(driven(tmp_path, bump=0.0), seed=0, threads=1)


@pytest.mark.parametrize(
    ("share", "digits", "text"),
    [(0.0312, 0, "3 %"), (0.00017, 1, "0.02 %"), (0.0, 1, "0.0 %"), (1.0, 0, "100 %"), (0.004, 0, "0.4 %")],
)
def test_a_share_is_never_shown_as_none(share, digits, text):
    assert percent(share, digits) == text
