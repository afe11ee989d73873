"""Logs of real machines through the commands' stages, against published values. Skipped where the logs are absent."""

from __future__ import annotations

from pathlib import Path

import pytest
from diagnosing import look_among

from capture_cli.stages import diagnose as diagnose_stage
from capture_cli.stages import identify as stage
from capture_cli.stages.diagnose import diagnose
from capture_cli.stages.documents.estimate_document import Report
from capture_cli.stages.import_log import import_log

EXAMPLES = Path(__file__).resolve().parents[1] / "docs" / "examples"
# Janot, Gautier and Brunot (2019): value, and how far off a fit with one friction for both directions may be
EMPS = {"mass": (95.11, 0.03), "damping": (203.5, 0.08), "coulomb": (20.39, 0.09)}


@pytest.fixture(autouse=True)
def without_the_slow_parts(monkeypatch):
    """Pages and the estimate of each recording alone have tests of their own."""
    for command in (stage, diagnose_stage):
        monkeypatch.setattr(command, "_write_pages", lambda *_: None)
    monkeypatch.setattr(Report, "_recordings", lambda *_: None)


def identify(folder: Path, task: Path, files: list[Path], **options) -> dict:
    """Import the files and identify from them; the estimate's document."""
    assert files
    import_log(files=files, task=str(task), out=folder / "log.zarr")
    return stage.identify(
        real_log=folder / "log.zarr", task=str(task), out=folder / "e", starts=1, quiet=True, **options
    ).document


def test_emps(real_data, tmp_path):
    files = sorted((real_data / "emps").glob("*.csv"))
    found = identify(tmp_path, EXAMPLES / "emps" / "task.toml", files, test="emps_test_pulses")
    assert found["error"]["test"]["rmse"]["q"] <= 0.73e-3
    for name, (published, tolerance) in EMPS.items():
        p = found["parameters"][name]
        assert p["value"] == pytest.approx(published, rel=tolerance), name
        assert p["identifiable"]
        assert not p["at_bound"]
    assert found["verdict"] == "unexplained"  # friction that depends on the direction is missing


def test_emps_without_its_friction(real_data, tmp_path, monkeypatch):
    """No model reaches its floor of 17 nm. A play of five parameters would do better than either of the two alone.

    200 of the 1000 rows of a second tell the same, in a tenth of the time.
    """
    look_among(
        monkeypatch,
        "coulomb-friction",
        "direction-dependent-viscous",
        "direction-dependent-coulomb",
        "backlash",
    )
    task, log = EXAMPLES / "emps" / "mass_and_damping.toml", tmp_path / "log.zarr"
    files = []
    for file in sorted((real_data / "emps").glob("*.csv")):
        header, *rows = file.read_text().splitlines(keepends=True)
        files.append(tmp_path / file.name)
        files[-1].write_text("".join([header, *rows[::5]]))
    import_log(files=files, task=str(task), out=log)
    options = {"test": "emps_test*", "expression": False, "threads": 1, "quiet": True}
    found = diagnose(real_log=log, task=str(task), out=tmp_path / "d", **options).document
    assert {e["name"] for e in found["effects"]} == {"coulomb-friction", "direction-dependent-viscous"}
    assert found["after"]["test"]["rmse"]["q"] <= 0.52e-3


def test_xl330(real_data, tmp_path):
    trajectories = ("sin_sin", "sin_time_square", "up_and_down")
    files = sorted(f for t in trajectories for f in (real_data / "bam_xl330").glob(f"*_{t}.csv"))
    assert len(files) == 12
    found = identify(tmp_path, EXAMPLES / "xl330" / "task.toml", files, test="*kp400*", rounds=40)
    assert found["error"]["test"]["mae"]["q"] <= 0.062
    assert found["split"]["how"].count("kp400") == 3
    together = {"motor_constant", "resistance", "damping"}
    undetermined = {name for name, p in found["parameters"].items() if not p["identifiable"]}
    assert {"motor_constant", "resistance"} <= undetermined <= together
    assert [set(u["combination"]) for u in found["undetermined"]] == [together]
    assert found["verdict"] == "unexplained"  # its friction grows with the load
