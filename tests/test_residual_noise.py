"""The noise floor of slow sensors before fast motion: from what the declared model leaves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosing import look_among
from held_inputs import hold
from slow_sensors import regular, thinned, with_sparse

from capture_cli.estimate.fit import Fit
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.noise.residual_noise import _of_outliers, with_noise_of_residual
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.white_noise import from_differences, white_noise
from capture_cli.model.tasks import load_task
from capture_cli.stages.diagnose import diagnose
from capture_cli.stages.identify import identify
from capture_cli.stages.record import record

NOISE = 1e-3  # rad, of both joints
LOOKED_FOR = (
    "coulomb-friction",
    "viscous-damping",
    "stribeck-friction",
    "load-dependent-friction",
    "constant-force",
)
LOOKED_FOR += ("control-delay", "control-gain", "sensor-delay", "sensor-bias", "sensor-quantisation")
FRICTION = 0.02  # N m, at an elbow that spins


def whirling(folder: Path, *effects: str, noise: float = NOISE) -> tuple[Path, Path]:
    """A log of an arm whose forearm turns fast, seen by a camera of 25 Hz, and its task.toml."""
    task = hold(with_sparse(folder / "task", "arm", "q2"), 0.005)
    made = record(
        task=str(task),
        out=folder / "whole.zarr",
        duration=3.0,
        rate=100,
        seed=2,
        random_parameters=True,
        noise={"q1": noise, "q2": noise},
        episodes=6,
        threads=1,
        effects=list(effects),
    )
    thinned(made.log, "q2", regular, 2).write(folder / "log.zarr")
    return folder / "log.zarr", task


def sliding(task: Path, folder: Path, *effects: str, episodes: int = 1) -> PreparedLog:
    """A log that is sampled often enough."""
    hold(task, 0.005)
    options = {"amplitude": {"drive": 8}, "noise": 1e-3, "duration": 4, "rate": 100, "threads": 1}
    made = record(
        task=str(task), out=folder / "log.zarr", episodes=episodes, effects=list(effects), **options
    )
    return prepare(made.log, load_task(str(task)), threads=1)


def fitted(prepared: PreparedLog) -> tuple[PreparedLog, Fit]:
    part = prepared.part(~prepared.split.is_test)
    return part, ModelFits(prepared, 1).fit(part, [], prepared.task.space.nominal)


def prepared_log(path: Path, task: Path) -> PreparedLog:
    return prepare(MeasuredLog.read(path), load_task(str(task)), threads=1)


def test_the_floor_of_a_slow_sensor_is_that_of_the_residual(tmp_path, without_pages):
    log, task = whirling(tmp_path)
    assert prepared_log(log, task).noise.sd[1] > 5 * NOISE
    found = identify(real_log=log, task=str(task), out=tmp_path / "estimate", threads=1, quiet=True).document
    assert found["noise_floor"] == {
        "q1": pytest.approx(NOISE, rel=0.1),
        "q2": pytest.approx(NOISE, rel=0.2),
    }
    assert found["noise_floor_source"] == {"q1": "differences", "q2": "residual"}
    assert found["verdict"] == "explained"
    assert 0.8 < found["error"]["test"]["normalized"] < 1.1


def test_what_a_floor_too_high_would_hide_is_found(tmp_path, without_pages, monkeypatch):
    look_among(monkeypatch, *LOOKED_FOR)
    log, task = whirling(tmp_path, f"coulomb-friction@elbow={FRICTION}")
    found = diagnose(real_log=log, task=str(task), out=tmp_path / "diagnosis", threads=1, quiet=True).document
    assert [e["name"] for e in found["effects"]] == ["coulomb-friction"]
    assert found["effects"][0]["site"] == "elbow"
    assert found["effects"][0]["parameters"]["friction"]["value"] == pytest.approx(FRICTION, rel=0.1)
    assert found["noise_floor_source"]["q2"] == "residual"


def test_floors_of_other_sources_stay(tmp_path):
    prepared = prepared_log(*whirling(tmp_path))
    part, fit = fitted(prepared)
    for source in ("declared", "repeats", "resolution"):
        noise = replace(prepared.noise, source=(source,) * 2)
        told, told_part = (replace(log, noise=noise) for log in (prepared, part))
        assert with_noise_of_residual(told, told_part, fit, 1) is told


def test_a_floor_that_is_right_stays(slider_task, tmp_path):
    prepared = sliding(slider_task, tmp_path)
    assert with_noise_of_residual(prepared, *fitted(prepared), 1) is prepared


def test_where_there_is_no_noise_there_is_none_to_be_found(tmp_path):
    prepared = prepared_log(*whirling(tmp_path, noise=0.0))
    quieter = with_noise_of_residual(prepared, *fitted(prepared), 1)
    assert quieter.noise.sd[1] > 1e-9


def test_what_falls_on_and_on_is_no_noise():
    time = np.linspace(0, 1, 40)
    smooth = np.sin(20 * time)
    noise = 1e-3 * np.random.default_rng(0).standard_normal((5, 40))
    assert white_noise([smooth], [time]) is None
    assert white_noise([smooth] * 5 + noise, [time] * 5) == pytest.approx(1e-3, rel=0.2)
    assert from_differences([smooth], [time]) > 0


def test_leverages_add_up_to_the_numbers_that_starts_amount_to(slider_task, tmp_path):
    prepared = sliding(slider_task, tmp_path)
    _, fit = fitted(prepared)
    assert fit.at.leverage.sum() == pytest.approx(fit.at.fitted_initial)
    assert (fit.at.leverage >= 0).all() and (fit.at.leverage < 1).all()


def disturbed(log: MeasuredLog, share: float, size: float) -> MeasuredLog:
    """The log with a share of samples that are off by so much, one by one."""
    random = np.random.default_rng(4)
    off = size * random.choice([-1.0, 1.0], log.outputs.shape) * (random.random(log.outputs.shape) < share)
    return replace(log, outputs=log.outputs + off)


def test_outliers_are_noise_and_nothing_that_a_model_lacks(slider_task, tmp_path, without_pages, monkeypatch):
    share, size = 0.01, 8.0
    look_among(monkeypatch, *LOOKED_FOR)
    log = sliding(slider_task, tmp_path, episodes=5).log
    disturbed(log, share, size * 1e-3).write(tmp_path / "outliers.zarr")
    options = {"real_log": tmp_path / "outliers.zarr", "task": str(slider_task), "threads": 1}
    found = identify(out=tmp_path / "estimate", quiet=True, **options).document
    assert list(found["noise_floor_source"].values()) == ["outliers"]
    assert next(iter(found["noise_floor"].values())) == pytest.approx(
        1e-3 * np.sqrt(1 + share * size**2), rel=0.1
    )
    assert found["verdict"] == "explained"
    diagnosis = diagnose(out=tmp_path / "diagnosis", quiet=True, **options).document
    assert diagnosis["verdict"] == "explained" and not diagnosis["effects"]


def test_an_effect_is_found_before_outliers(slider_task, tmp_path, without_pages, monkeypatch):
    """While it is missing they cannot be told from what it does, and with it they are all that is left."""
    look_among(monkeypatch, *LOOKED_FOR)
    log = sliding(slider_task, tmp_path, "coulomb-friction@x=0.5", episodes=5).log
    disturbed(log, 0.01, 8e-3).write(tmp_path / "outliers.zarr")
    found = diagnose(
        real_log=tmp_path / "outliers.zarr", task=str(slider_task), out=tmp_path / "d", threads=1, quiet=True
    ).document
    assert [e["name"] for e in found["effects"]] == ["coulomb-friction"]
    assert found["verdict"] in ("effect-found", "tied")
    assert list(found["noise_floor_source"].values()) == ["outliers"]


def test_what_moves_is_no_outlier():
    """A peak of a few samples, and a jump."""
    random = np.random.default_rng(0)
    peak, jump = random.standard_normal((2, 400))
    peak[200:205] += [5, 9, 12, 9, 5]
    jump[200:] += 9.0
    alone = random.standard_normal(400)
    assert _of_outliers([peak]) == _of_outliers([jump]) == _of_outliers([alone]) == 0
    alone[200] += 9.0
    assert _of_outliers([alone]) == pytest.approx(81 / 400, rel=0.4)
