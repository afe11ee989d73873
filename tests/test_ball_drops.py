"""Filmed ball drops through `diagnose`: drag where there is drag, nothing where the tracking error is all there is.

Skipped where the logs are absent.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from diagnosing import look_among

from capture_cli.stages import diagnose as stage
from capture_cli.stages.import_log import import_log

TASK = str(Path(__file__).resolve().parents[1] / "docs" / "examples" / "ball_drop" / "task.toml")
LINEAR, QUADRATIC = {"viscous-damping", "medium-viscosity"}, {"quadratic-drag", "medium-density"}

OTHERS = (
    "cubic-drag",
    "constant-force",
    "gravity-magnitude",
    "wind",
    "payload",
    "sensor-bias",
    "sensor-scale",
    "sensor-delay",
)


@pytest.fixture
def found(real_data, tmp_path, monkeypatch):
    """What is found of a ball: for every effect, the names it goes by."""
    monkeypatch.setattr(stage, "_write_pages", lambda *_: None)

    def diagnose(ball: str) -> list[set[str]]:
        log = tmp_path / "log.zarr"
        import_log(files=[real_data / "ball_drops" / f"{ball}.csv"], task=TASK, out=log)
        document = stage.diagnose(
            real_log=log, out=tmp_path / "d", task=TASK, test="none", expression=False, threads=1, quiet=True
        ).document
        return [{e["name"], *(t.split("@")[0] for t in e["tied_with"])} for e in document["effects"]]

    return diagnose


def test_the_drag_of_a_tennis_ball_is_linear_or_quadratic(found, monkeypatch):
    look_among(monkeypatch, *LINEAR, *QUADRATIC, *OTHERS)
    (names,) = found("tennis_ball")
    assert names & LINEAR
    assert names & QUADRATIC


@pytest.mark.parametrize("ball", ["bowling_ball", "baseball"])
def test_nothing_is_found_where_two_drops_show_nothing(found, ball, monkeypatch):
    look_among(monkeypatch, *LINEAR, *QUADRATIC, *OTHERS)
    assert found(ball) == []
