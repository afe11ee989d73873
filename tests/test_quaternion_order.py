"""Columns of a quaternion that are not w, x, y, z are told by their names, and by a body that stays upright."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from inspecting import inspect
from scipy.spatial.transform import Rotation

from capture_cli.model.quaternion_order import order_in_names
from capture_cli.stages.import_log import import_log

STEPS = 400


@pytest.mark.parametrize(
    ("columns", "order"),
    [
        (("qw", "qx", "qy", "qz"), (0, 1, 2, 3)),
        (("qx", "qy", "qz", "qw"), (3, 0, 1, 2)),
        (
            ("pose.orientation.x", "pose.orientation.y", "pose.orientation.z", "pose.orientation.w"),
            (3, 0, 1, 2),
        ),
        (("q[Z]", "q[Y]", "q[X]", "q[W]"), (3, 2, 1, 0)),
        (("q0", "q1", "q2", "q3"), None),
        (("qx", "qy", "qz", "q"), None),
        (("", "x", "y", "z"), None),
    ],
)
def test_names_end_in_what_they_are(columns, order):
    assert order_in_names(columns) == order


def findings(folder: Path, columns: str, attitude: np.ndarray, frame: str = "") -> list[dict[str, str]]:
    """The warnings of `inspect` on a log of a free body: its attitude (step, 4) in four columns.

    frame: the body's own pose in the model.
    """
    (folder / "model.xml").write_text(
        f'<mujoco><worldbody><body {frame}><freejoint/><geom size=".1"/><site name="s"/></body></worldbody>'
        '<sensor><framequat name="turn" objtype="site" objname="s"/></sensor></mujoco>'
    )
    names = columns.split()
    quoted = ", ".join(f'"{name}"' for name in names)
    (folder / "task.toml").write_text(
        'format = 1\nname = "drone"\nmodel = "model.xml"\n'
        f'[outputs.turn]\ncolumn = [{quoted}]\nunit = "1"\n[log]\nwindow = 0.5\n'
    )
    rows = [",".join(["time", *names])]
    rows += [",".join(f"{v:.6f}" for v in (k / 200, *q)) for k, q in enumerate(attitude)]
    (folder / "run.csv").write_text("\n".join(rows) + "\n")
    import_log(files=[folder / "run.csv"], task=str(folder / "task.toml"), out=folder / "run.zarr")
    return [f for f in inspect(folder / "run.zarr")["findings"] if f["severity"] == "warning"]


def upright(turned: float) -> np.ndarray:
    """Attitudes (step, 4), w last, of a body that sways by 0.2 rad and turns about its vertical by so many rad."""
    time = np.linspace(0, 2, STEPS)
    sway = 0.2 * np.stack([np.sin(5 * time), np.cos(7 * time)], axis=1)
    angles = np.concatenate([(turned * time / 2)[:, None], sway], axis=1)
    return Rotation.from_euler("ZYX", angles).as_quat()


@pytest.mark.parametrize("turned", [0.3, 9.0])
def test_a_body_that_stays_upright_if_w_is_last(tmp_path, turned):
    (found,) = findings(tmp_path, "a b c d", upright(turned))
    assert found["where"] == "output turn"
    assert "a, b, c, d, are read as w, x, y, z" in found["message"] and "as x, y, z, w" in found["message"]
    assert 'column = ["d", "a", "b", "c"]' in found["cure"]


def test_names_say_it_whatever_the_values(tmp_path):
    tumbling = Rotation.from_rotvec(np.linspace(0, 6, STEPS)[:, None] * [0.5, 0.7, -0.4]).as_quat()
    (found,) = findings(tmp_path, "qx qy qz qw", tumbling)
    assert "qx, qy, qz, qw, are read as w, x, y, z, and their names say x, y, z, w" in found["message"]
    assert 'column = ["qw", "qx", "qy", "qz"]' in found["cure"]


@pytest.mark.parametrize("names", ["qw qx qy qz", "a b c d"])
def test_what_is_w_first_is_left_alone(tmp_path, names):
    assert findings(tmp_path, names, upright(9.0)[:, [3, 0, 1, 2]]) == []


def test_a_body_that_tumbles_or_begins_half_a_turn_round_says_nothing(tmp_path):
    tumbling = Rotation.from_rotvec(np.linspace(0, 6, STEPS)[:, None] * [0.5, 0.7, -0.4]).as_quat()
    assert findings(tmp_path, "a b c d", tumbling) == []
    backwards = tmp_path / "backwards"
    backwards.mkdir()
    assert findings(backwards, "a b c d", upright(0.3), 'quat="0 0 0 1"') == []
