"""`diagnose --time-limit`: a whole result with the best so far, which says that it was ended."""

from __future__ import annotations

import pytest
from diagnosing import look_among
from held_inputs import held_machine

from capture_cli.errors import CaptureError
from capture_cli.report.diagnosis_findings import notes
from capture_cli.select.explain import Settings
from capture_cli.select.search import Attribution
from capture_cli.stages.diagnose import diagnose
from capture_cli.stages.record import record
from capture_cli.store.diagnosis import Diagnosis, DiagnosisRecord

ASKED = {"starts": 1, "threads": 1, "quiet": True, "expression": False}
PLANTED = ["coulomb-friction@x=1.5", "sensor-bias@q=0.05"]


FEW = ("coulomb-friction", "sensor-bias", "constant-force", "cogging", "stribeck-friction")


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """A search among a few effects is a fast one."""
    look_among(monkeypatch, *FEW)


@pytest.fixture(scope="module")
def asked(tmp_path_factory) -> dict:
    """Options of a diagnosis of a log with two effects."""
    folder = tmp_path_factory.mktemp("log")
    task = str(held_machine(folder / "slider", "slider", 0.004))
    options = {"noise": 5e-4, "episodes": 4, "duration": 1.5, "rate": 250.0, "threads": 1}
    record(task=task, out=folder / "log.zarr", effects=PLANTED, **options)
    return {"task": task, "real_log": folder / "log.zarr", **ASKED}


def test_no_time_at_all_is_a_whole_result_without_effects(asked, tmp_path):
    found = diagnose(out=tmp_path / "d", time_limit=0.0, **asked).document
    assert found["verdict"] == "unexplained" and found["effects"] == []
    assert "time limit" in found["out_of_time"] and found["out_of_time"] in notes(DiagnosisRecord.of(found))
    assert (tmp_path / "d" / "report.html").is_file()
    # a run that may search longer takes it for another one
    with pytest.raises(CaptureError, match="time_limit"):
        diagnose(out=tmp_path / "d", resume=True, **asked)


def test_what_was_found_until_then_stands(asked, tmp_path, monkeypatch, without_pages):
    over, keep = [], Attribution._keep

    def kept(self, current):
        over.extend([True] * bool(self.accepted))
        return keep(self, current)

    monkeypatch.setattr(Attribution, "_keep", kept)
    monkeypatch.setattr(Settings, "is_over", property(lambda _: bool(over)))
    found = diagnose(out=tmp_path / "d", time_limit=1e6, **asked).document
    assert found["effects"] and found["out_of_time"]
    assert len(found["stages"]) == len(found["effects"]) + 1
    assert Diagnosis.read(tmp_path / "d").document == found


def test_without_a_limit_nothing_is_ended(asked, tmp_path, without_pages):
    found = diagnose(out=tmp_path / "d", time_limit=1e6, **asked).document
    # on a linear spring a bias of its sensor is a constant force; both together, or one alone would be cogging
    names = {name.partition("@")[0] for e in found["effects"] for name in [e["name"], *e["tied_with"]]}
    assert len(found["effects"]) == 2 and names >= {"coulomb-friction", "sensor-bias"}
    assert found["out_of_time"] is None
