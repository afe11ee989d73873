"""Stamps that are off at random are named as what makes noise grow with the speed; delays and forces are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosing import look_among
from inspecting import inspect
from scipy.interpolate import CubicSpline

from capture_cli.estimate.noise.time_stamp_jitter import _settled
from capture_cli.report import findings
from capture_cli.stages.diagnose import diagnose
from capture_cli.stages.identify import identify
from capture_cli.stages.record import record
from capture_cli.store.estimate import EstimateRecord

MACHINE = Path(__file__).resolve().parents[1] / "benchmarks" / "machines" / "slider"
NOISE = 1e-4  # m
OFF = 1e-3  # s, standard deviation


@pytest.fixture
def task(tmp_path) -> Path:
    """The slider, with the floor of its sensor known."""
    (tmp_path / "model.xml").write_text((MACHINE / "model.xml").read_text())
    text = (MACHINE / "task.toml").read_text().replace("[outputs.q]", f"[outputs.q]\nnoise_sd = {NOISE}")
    (tmp_path / "task.toml").write_text(text)
    return tmp_path / "task.toml"


def recorded(task: Path, *effects: str, off: float = OFF) -> Path:
    """A log whose samples are taken off their stamps at random, by so many s."""
    path, generator = task.parent / "log.zarr", np.random.default_rng(3)
    options = dict(random_parameters=True, episodes=2, duration=4.0, rate=250.0, seed=1, threads=1)
    log = record(task=str(task), out=path, effects=list(effects), **options).log
    for e in log.episodes:
        time = log.time[e]
        taken = np.clip(time + generator.normal(0, off, len(time)), time[0], time[-1])
        log.outputs[e] = CubicSpline(time, log.outputs[e])(taken)
    noise = generator.normal(0, NOISE, log.outputs.shape)
    path = path.with_name("off.zarr")
    replace(log, outputs=log.outputs + noise).write(path)
    return path


def found(task: Path, log: Path):
    out = task.parent / "estimate"
    return identify(real_log=log, task=str(task), out=out, threads=1, quiet=True).document


def test_a_sound_machine_with_such_stamps_is_said_to_be_one(task, without_pages):
    log = recorded(task)
    document = found(task, log)
    assert document["verdict"] == "unexplained"
    assert document["time_stamps"]["outputs"]["q"]["sd"] == pytest.approx(OFF, rel=0.1)
    assert document["time_stamps"]["outputs"]["q"]["share"] > 0.9
    assert document["time_stamps"]["explained"] == 1
    assert "Time-stamp jitter explains all of that." in document["summary"]
    assert document["time_stamps"]["text"] in findings.notes(EstimateRecord.of(document))
    assert document["next_command"] is None
    cures = [f["cure"] for f in inspect(task.parent / "estimate")["findings"]]
    assert document["time_stamps"]["text"] in cures


def test_diagnose_says_so_too(task, without_pages, monkeypatch):
    look_among(monkeypatch, "coulomb-friction")
    out = task.parent / "diagnosis"
    options = dict(expression=False, threads=1, quiet=True)
    document = diagnose(real_log=recorded(task), task=str(task), out=out, **options).document
    assert document["time_stamps"]["explained"] == 1
    assert document["summary"].endswith("Time-stamp jitter explains all of that.")


@pytest.mark.parametrize("effect", [(), ("sensor-delay@q=0.004",), ("coulomb-friction@x=0.5",)])
def test_true_stamps_are_not_suspected(task, without_pages, effect):
    document = found(task, recorded(task, *effect, off=0.0))
    assert document["time_stamps"] is None
    assert document["verdict"] == ("unexplained" if effect else "explained")
    assert bool(document["next_command"]) == bool(effect)


def test_a_delay_beside_them_is_still_to_be_found(task, without_pages):
    document = found(task, recorded(task, "sensor-delay@q=0.01"))
    assert document["time_stamps"]["outputs"]["q"]["sd"] == pytest.approx(OFF, rel=0.1)
    assert document["time_stamps"]["explained"] < 1
    assert "diagnose" in document["next_command"]


def test_no_stamp_is_off_by_less_than_its_number_holds(tmp_path, without_pages):
    """Without noise, what rounding leaves grows with the speed, too."""
    log, task = tmp_path / "exact.zarr", str(MACHINE.with_name("pan_tilt") / "task.toml")
    record(task=task, out=log, random_parameters=True, duration=4.0, rate=500.0, seed=1, threads=1)
    found = identify(real_log=log, task=task, out=tmp_path / "estimate", threads=1, quiet=True).document
    assert found["time_stamps"] is None


# --- series ---


def shaken(n: int = 4000) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    """Times of samples, s, and the speed of something that moves at a few Hz."""
    time = np.arange(n) * 4e-3
    return time, np.sin(9 * time) + 0.6 * np.sin(23 * time), np.random.default_rng(0)


def test_noise_that_grows_with_the_speed_is_measured():
    time, speed, generator = shaken()
    values = generator.normal(size=len(time)) * np.sqrt(0.25 + 4 * np.square(speed))
    still, slope = _settled([values], [time], [speed])
    assert still == pytest.approx(0.25, rel=0.2)
    assert slope == pytest.approx(4, rel=0.15)


def test_noise_that_does_not_grow_a_constant_delay_and_what_is_smooth_are_not():
    time, speed, generator = shaken()
    white = generator.normal(size=len(time))
    assert _settled([white], [time], [speed]) is None
    assert _settled([white + 30 * speed], [time], [speed]) is None
    assert _settled([white + 30 * speed * np.abs(speed)], [time], [speed]) is None


def test_a_constant_delay_of_motion_that_is_not_smooth_is_none():
    """As of a speed sensor on what is driven by noise: its acceleration jumps from sample to sample."""
    time, _, generator = shaken()
    jumps = generator.normal(size=len(time))
    assert _settled([0.1 * generator.normal(size=len(time)) + jumps], [time], [jumps]) is None


def test_a_few_impacts_are_no_growth():
    time, speed, generator = shaken()
    values = generator.normal(size=len(time))
    fast = np.flatnonzero(np.abs(speed) > 1.3)[::40]
    values[fast] += 30.0
    assert _settled([values], [time], [speed]) is None


def test_a_motion_that_never_moves_or_is_short_says_nothing():
    time, _, generator = shaken(400)
    values = generator.normal(size=len(time))
    assert _settled([values], [time], [np.ones(len(time))]) is None
    assert _settled([values], [time], [np.zeros(len(time))]) is None
    assert _settled([values[:50]], [time[:50]], [time[:50]]) is None
    assert _settled([], [], []) is None
