"""What is held out and not explained: a lack, but where the fit leaves the parameters open that would explain it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosing import look_among
from inspecting import inspect
from setting_numbers import set_numbers

from capture_cli.estimate.extrapolation import beyond_fitted
from capture_cli.report import findings
from capture_cli.stages import identify as stage
from capture_cli.stages.diagnose import diagnose
from capture_cli.stages.identify import identify
from capture_cli.stages.import_log import import_log
from capture_cli.stages.record import record
from capture_cli.store.estimate import EstimateRecord

SLIDER = Path(__file__).resolve().parents[1] / "benchmarks" / "machines" / "slider" / "task.toml"


@pytest.fixture(autouse=True)
def without_pages(monkeypatch):
    """Reports have tests of their own."""
    monkeypatch.setattr(stage, "_write_pages", lambda *_: None)
    monkeypatch.setattr("capture_cli.stages.diagnose._write_pages", lambda *_: None)


@pytest.fixture(scope="module")
def strokes(tmp_path_factory) -> Path:
    """With this seed no fitted stroke is near enough to the centre of mass to tell its side of the spatula."""
    log = tmp_path_factory.mktemp("strokes") / "log.zarr"
    record(task="scooping", out=log, random_parameters=True, noise=2e-3, episodes=10, seed=1)
    return log


def test_a_rod_that_tips_for_the_first_time_where_it_is_held_out_is_explained(strokes, tmp_path, monkeypatch):
    look_among(
        monkeypatch, "coulomb-friction", "control-bias", "control-delay", "sensor-bias", "sensor-scale"
    )
    estimate, options = tmp_path / "estimate", {"real_log": strokes, "starts": 1, "quiet": True, "threads": 1}
    found = identify(out=estimate, **options).document
    assert found["error"]["test"]["normalized"] > 3
    assert found["verdict"] == "explained"
    assert found["held_out"]["error"]["test"]["normalized"] < 1.1
    low, high = found["parameters"]["com"]["ci95"]
    assert low <= found["held_out"]["parameters"]["com"] <= high
    assert any("com" in note and "Held-out" in note for note in findings.notes(EstimateRecord.of(found)))
    document = diagnose(estimate=estimate, out=tmp_path / "diagnosis", **options).document
    assert (document["verdict"], document["effects"]) == ("explained", [])


def test_parameters_that_the_fit_hardly_minds_need_not_be_within_their_intervals(
    strokes, tmp_path, monkeypatch
):
    """As intervals take the simulator for exact."""
    monkeypatch.setattr("capture_cli.estimate.held_out._by_chance", lambda *_: False)
    options = {"real_log": strokes, "starts": 1, "quiet": True, "threads": 1}
    found = identify(out=tmp_path / "estimate", **options).document
    assert (found["verdict"], found["held_out"] is None) == ("explained", False)
    set_numbers(monkeypatch, "capture_cli.estimate.held_out", next_to_nothing=-1.0)
    assert identify(out=tmp_path / "minded", **options).document["verdict"] == "unexplained"


@pytest.fixture
def changed(tmp_path) -> Path:
    """A log of two recordings, "before" and "after" the slider became a little heavier."""
    kept, heavier = (
        record(
            task=str(SLIDER),
            out=tmp_path / f"{mass}.zarr",
            parameters={"mass": mass},
            noise=5e-4,
            episodes=3,
            duration=1.5,
            rate=250,
            threads=1,
            seed=seed,
        ).log
        for seed, mass in enumerate((1.4, 1.406))
    )
    both = replace(
        kept,
        **{n: np.concatenate([getattr(kept, n), getattr(heavier, n)]) for n in ("inputs", "outputs")},
        time=np.concatenate([kept.time, kept.time[-1] + 1 + heavier.time]),
        episode_ends=np.concatenate([kept.episode_ends, kept.episode_ends[-1] + heavier.episode_ends]),
        recording=np.array([0, 0, 0, 1, 1, 1]),
        recordings=tuple({"name": name, "source": "", "sha256": ""} for name in ("before", "after")),
    )
    both.write(tmp_path / "log.zarr")
    return tmp_path / "log.zarr"


def test_a_machine_that_changed_before_what_is_held_out_is_not_explained(changed, tmp_path):
    """One mass for both recordings would leave little of either, but not one that the fitted recording allows."""
    options = {"task": str(SLIDER), "test": "after", "starts": 1, "quiet": True, "threads": 1}
    found = identify(real_log=changed, out=tmp_path / "estimate", **options).document
    assert found["error"]["fit"]["normalized"] < 1.1
    assert (found["verdict"], found["held_out"]) == ("unexplained", None)
    assert found["next_command"] is None
    assert "--test none" in found["summary"]
    advice = [f["cure"] for f in inspect(tmp_path / "estimate")["findings"] if f["where"] == "verdict"]
    assert ["--test none" in cure and "capture diagnose" not in cure for cure in advice] == [True]


def test_where_what_was_fitted_is_explained_no_formula_is_looked_for(changed):
    found = diagnose(
        real_log=changed,
        task=str(SLIDER),
        test="after",
        starts=1,
        quiet=True,
        threads=1,
        out=changed.with_name("d"),
    )
    document = found.document
    assert (document["verdict"], document["effects"]) == ("unexplained", [])
    assert not document["lack_of_fit"]["after"]["lacking"]
    assert document["expression"] is None


@pytest.fixture
def farther(tmp_path) -> Path:
    """A log of two recordings of the slider on a stiffening spring, "near" and "far", which goes where it shows."""
    for name, amplitude in (("near", 1.0), ("far", 8.0)):
        record(
            task=str(SLIDER),
            out=tmp_path / f"{name}.zarr",
            effects=["cubic-stiffness@x=400"],
            amplitude={"drive": amplitude},
            noise=5e-4,
            episodes=3,
            duration=1.5,
            rate=250,
            threads=1,
        )
    import_log(
        files=[tmp_path / "near.zarr", tmp_path / "far.zarr"], task=str(SLIDER), out=tmp_path / "log.zarr"
    )
    return tmp_path / "log.zarr"


def test_where_it_goes_farther_than_all_that_was_fitted_is_said(farther, tmp_path, monkeypatch):
    look_among(monkeypatch, "coulomb-friction")
    options = {"task": str(SLIDER), "test": "far", "starts": 1, "quiet": True, "threads": 1}
    found = identify(real_log=farther, out=tmp_path / "estimate", **options).document
    beyond = found["beyond_fitted"]
    low, high = beyond["fitted"]
    assert found["verdict"] == "unexplained" and found["lack_of_fit"]["normalized"] < 1.1
    assert not low <= beyond["reached"] <= high and beyond["share"] > 0.5
    assert beyond["text"] in found["summary"] and "--test none" in found["summary"]
    diagnosed = diagnose(real_log=farther, out=tmp_path / "diagnosis", **options).document
    assert beyond["text"] in diagnosed["summary"]
    advice = [f["cure"] for f in inspect(tmp_path / "estimate")["findings"] if f["where"] == "verdict"]
    assert [beyond["text"] in cure for cure in advice] == [True]


FITTED, HELD = [[0.0, 1.0], [-1.0, 0.5]], [[0.0, 3.0], [-1.5, 0.0], [0.2, 0.4]]  # of one output, by window


@pytest.mark.parametrize(
    ("held", "errors", "reached", "share"),
    [
        (HELD, [8.0, 1.0, 1.0], 3.0, 0.9),
        (HELD, [1.0, 8.0, 1.0], 3.0, 0.9),  # the farthest of the windows that leave it
        (HELD, [1.0, 1.0, 8.0], None, None),  # most of the error is where it stays within
        ([[0.0, 1.1]] * 3, [1.0, 1.0, 1.0], None, None),  # as any two parts differ
        (HELD, [np.nan, 1.0, 1.0], None, None),  # the simulation ran away
        ([[np.nan, np.nan]] * 3, [1.0, 1.0, 1.0], None, None),  # never sampled
        ([[np.nan, -4.0], [0.0, 1.0], [0.0, 1.0]], [8.0, 1.0, 1.0], -4.0, 0.8),
    ],
)
def test_the_output_leaves_its_fitted_range_where_the_error_is(held, errors, reached, share):
    measured = np.array([*FITTED, *held])[..., None]
    residual = np.sqrt(np.array([1.0, 1.0, *errors]))[:, None]
    is_test = np.array([False, False, True, True, True])
    found = _beyond_of(measured, residual, is_test)
    assert (found and (found.reached, found.share)) == (reached and (reached, pytest.approx(share)))
    assert found is None or (found.low, found.high) == (-1.0, 1.0)
    assert _beyond_of(np.where(is_test[:, None, None], measured, np.nan), residual, is_test) is None


def _beyond_of(measured, residual, is_test):
    sampled = np.isfinite(measured)
    return beyond_fitted(np.where(sampled, measured, 0.0), sampled, residual, is_test)
