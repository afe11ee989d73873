"""Errors in open loop as people read them: at the terminal and on the page, of angles and of what diverged."""

from __future__ import annotations

import io

import pytest
from rich.console import Console
from test_diagnosis_page import make as make_diagnosis
from test_reports import make as make_estimate

from capture_cli.report import diagnosis_page, estimate_page
from capture_cli.report.prediction import for_terminal, predictions
from capture_cli.report.terminal import print_diagnosis, print_estimate
from capture_cli.store.estimate import EstimateRecord

OUTPUTS = [{"name": "elbow", "unit": "rad"}, {"name": "reach", "unit": "m"}]


def error(elbow: float | None, reach: float | None = None, diverged: int = 0) -> dict:
    rmse = {"elbow": elbow, "reach": reach}
    over = {name: None if value is None else value / 1e-3 for name, value in rmse.items()}
    return {"rmse": rmse, "over_floor": over, "normalized": over["elbow"], "diverged": diverged}


def part(**changed: dict) -> dict:
    """Two horizons, the second a free run of two recordings; in the first errors are a tenth."""
    models = {"nominal": error(0.05, 0.02), "identified": error(0.01, 0.004), **changed}
    runs = {"runs": 3, "longest": 60.0, "models": models}
    short = {
        name: error(0.1 * e["rmse"]["elbow"] if e["rmse"]["elbow"] else None) for name, e in models.items()
    }
    return {
        "horizons": [
            {"horizon": 0.1, "runs": 40, "longest": 0.1, "models": short},
            {"horizon": None, **runs},
        ],
        "recordings": {"morning": runs, "noon": {**runs, "longest": 34.0}},
        "left_out": ["No prediction over 2 s of what was held out: it is 1.5 s long at most."],
    }


def estimate(found: dict):
    record = make_estimate(outputs={"elbow": ("rad", 1e-3), "reach": ("m", 1e-3)})
    record.document["prediction"] = found
    return record


def diagnosis(found: dict):
    record = make_diagnosis({"elbow": ("rad", 1e-3), "reach": ("m", 1e-3)})
    record.document["prediction"] = found
    return record


def test_what_was_held_out_comes_first():
    found = predictions(EstimateRecord.of({"prediction": {"fit": part(), "test": part()}}), OUTPUTS)
    assert [p.part for p in found] == ["held out", "fitted"]
    assert [
        p.part for p in predictions(EstimateRecord.of({"prediction": {"fit": part(), "test": None}}), OUTPUTS)
    ] == ["fitted"]
    assert predictions(EstimateRecord.of({}), OUTPUTS) == []  # of earlier versions


def test_the_terminal_tells_angles_in_degrees_too():
    (found,) = predictions(EstimateRecord.of({"prediction": {"fit": None, "test": part()}}), OUTPUTS)
    assert for_terminal(found, most=8) == [
        ["open loop, held out", "0.1\u00a0s", "whole, 60.0\u00a0s", "times floor", "whole, nominal"],
        ["elbow [mrad]", "1.00", "10.0", "10.0", "50.0"],
        ["  in degrees", "0.0573", "0.573", "", "2.86"],
        ["reach [mm]", "–", "4.00", "4.00", "20.0"],
    ]
    assert [row[0] for row in for_terminal(found, most=1)[1:]] == ["elbow [mrad]", "  in degrees"]


def test_a_run_that_diverged_is_told_in_a_word():
    lost = part(nominal=error(None, diverged=2))
    (found,) = predictions(EstimateRecord.of({"prediction": {"fit": None, "test": lost}}), OUTPUTS)
    assert for_terminal(found, most=8)[1] == ["elbow [mrad]", "1.00", "10.0", "10.0", "diverged"]
    lost = part(identified=error(None, diverged=2))
    (found,) = predictions(EstimateRecord.of({"prediction": {"fit": None, "test": lost}}), OUTPUTS)
    assert for_terminal(found, most=1)[1] == ["elbow [rad]", "–", "diverged", "diverged", "0.0500"]


@pytest.mark.parametrize("width", [60, 80, 120])
def test_results_have_the_table_and_what_is_left_out(width):
    diagnosed = part(diagnosed=error(0.005, 0.002))
    for show, record, whole in (
        (print_estimate, estimate({"fit": part(), "test": part()}), "10.0"),
        (print_diagnosis, diagnosis({"fit": part(), "test": diagnosed}), "5.00"),
    ):
        out = io.StringIO()
        show(record, Console(file=out, width=width), "runs/result")
        text = out.getvalue()
        (row,) = [line.split() for line in text.splitlines() if line.startswith("elbow [mrad]")]
        assert whole in row
        assert "in degrees" in text
        assert "No prediction over 2 s" in text


def test_pages_have_both_parts_each_recording_and_degrees():
    found = {"fit": part(), "test": part(diagnosed=error(0.005, 0.002))}
    page = " ".join(diagnosis_page.render(diagnosis(found), None).split())
    for told in (
        "Error by prediction horizon",
        "Held out",
        "Fitted",
        "morning",
        "34.0",
        "No prediction over 2 s",
    ):
        assert told in page
    for told in ("50.0 → 10.0 →", "5.00 mrad", "2.86 → 0.573 →", "0.286 °", "5.00 ×"):
        assert told in page
    assert "Error by prediction horizon" in estimate_page.render(estimate(found), None)
    assert "Error by prediction horizon" not in estimate_page.render(make_estimate(), None)
