"""What is said of the model's time step, of a machine that was not simulated in any model's steps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from capture_cli.estimate.time_step import _may_be_worse
from capture_cli.stages import identify as stage
from capture_cli.stages.import_log import import_log

GRAVITY = 1.2 * 9.81 * 0.17  # N m
INERTIA = 0.012 + 1.2 * 0.17**2
KP, KV, DAMPING, FRICTION = 60.0, 2.5, 0.12, 0.25

MODEL = f"""
<mujoco model="servo">
  <option timestep="0.004" integrator="implicitfast"/>
  <worldbody>
    <body name="link">
      <joint name="hinge" type="hinge" axis="0 1 0" damping="0.1" frictionloss="0.1"/>
      <inertial pos="0 0 -0.17" mass="1.2" diaginertia="0.012 0.012 0.0005"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="hinge" kp="{KP}" kv="{KV}"/></actuator>
  <sensor><jointpos name="angle" joint="hinge"/></sensor>
</mujoco>
"""

TASK = """
format = 1
name = "servo"
model = "model.xml"

[parameters.damping]
set = "joint:hinge:damping"
low = 0.0
high = 1.0
unit = "N m s/rad"

[parameters.friction]
set = "joint:hinge:frictionloss"
low = 0.0
high = 1.0
unit = "N m"

[inputs.servo]
column = "command"
unit = "rad"
interpolate = "hold"

[outputs.angle]
column = "angle"
unit = "rad"

[log]
time = "t"
window = 0.5
"""


def commands(steps: int, rng: np.random.Generator) -> np.ndarray:
    """At 100 Hz, up to 0.7 rad, (step,)."""
    time = np.arange(steps) / 100
    waves = zip(rng.uniform(0.1, 1.2, 6), rng.uniform(0, 6.28, 6), strict=True)
    raw = sum(np.sin(2 * np.pi * hertz * time + phase) / (0.5 + hertz) for hertz, phase in waves)
    return 0.7 * raw / np.abs(raw).max()


def moved(commands: np.ndarray) -> np.ndarray:
    """The angle at each of the commands (step,), by the law of the servo in steps of 0.1 ms."""
    step, each = 1e-4, 100
    angle, speed, seen = 0.0, 0.0, []
    for command in commands:
        seen.append(angle)
        for _ in range(each):
            force = KP * (command - angle) - (KV + DAMPING) * speed - GRAVITY * np.sin(angle)
            free = speed + step * force / INERTIA
            speed = np.sign(free) * max(abs(free) - step * FRICTION / INERTIA, 0.0)
            angle += step * speed
    return np.array(seen)


@pytest.fixture
def servo(tmp_path) -> Path:
    """A folder with a servo's model in steps of 4 ms, its task, and 8 s of it by an encoder of 4096 counts."""
    rng = np.random.default_rng(8)
    given = commands(800, rng)
    count = 2 * np.pi / 4096
    angle = count * np.round((moved(given) + rng.normal(0, 3e-4, len(given))) / count)
    rows = "".join(f"{i / 100},{c:.6f},{a:.6f}\n" for i, (c, a) in enumerate(zip(given, angle, strict=True)))
    (tmp_path / "run.csv").write_text("t,command,angle\n" + rows)
    (tmp_path / "model.xml").write_text(MODEL)
    (tmp_path / "task.toml").write_text(TASK)
    return tmp_path


def test_of_a_servo_it_is_said_what_shorter_steps_make_of_damping_and_of_the_error(servo, monkeypatch):
    monkeypatch.setattr(stage, "_write_pages", lambda *_: None)
    task, log = str(servo / "task.toml"), servo / "log.zarr"
    import_log(files=[servo / "run.csv"], task=task, out=log, quiet=True)
    out = servo / "estimate"
    document = stage.identify(
        real_log=log, task=task, out=out, starts=1, threads=1, quiet=True, test="none"
    ).document
    found = document["parameters"]["damping"]["value"]
    assert abs(found - (DAMPING + 0.004 * KP / 2)) < 0.03  # what the integrator takes away of it
    said = document["time_step"]
    assert abs(said["parameters"]["damping"] - (DAMPING + 0.001 * KP / 2)) < 0.02
    assert said["error"] < 0.9 * document["lack_of_fit"]["normalized"]
    assert "in steps of 1 ms, and not 4, damping would be about" in said["text"]
    assert "the error would be about" in said["text"]


def test_shorter_steps_may_be_a_little_worse_where_the_models_own_leave_more_than_white_noise():
    left = 4000.0
    assert _may_be_worse(1.0, left) < 10  # as of a log that was simulated in the model's own steps
    assert _may_be_worse(3.0, left) == 80
    assert _may_be_worse(100.0, left) > 300  # by chance
