"""Coloured noise on repeats of one experiment is no lack of fit; and what is missing is found in spite of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from coloured_noise import coloured
from diagnosing import look_among
from gimbal import gimbal
from held_inputs import held_machine
from scipy.spatial.transform import Rotation

from capture_cli.estimate.noise.repeated_noise import with_noise_of_repeats
from capture_cli.estimate.prepare import prepare
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks import load_task
from capture_cli.stages.diagnose import diagnose
from capture_cli.stages.identify import identify
from capture_cli.stages.record import record

SLIDER = str(Path(__file__).parents[1] / "benchmarks" / "machines" / "slider" / "task.toml")
NOISE, MEMORY = 1e-3, 8.0  # m; samples within which it is forgotten


@pytest.fixture(scope="module", params=[(), ("coulomb-friction@x.friction=1.5",)], ids=["nothing", "coulomb"])
def repeats(request, tmp_path_factory) -> tuple[Path, str, bool]:
    """A log of two experiments on the slider, each run three times, its task, and whether something is missing."""
    folder = tmp_path_factory.mktemp("repeats")
    once, task = folder / "once.zarr", str(held_machine(folder / "slider", "slider", 0.004))
    record(task=task, out=once, effects=list(request.param), noise=0.0, episodes=2, duration=2.5, rate=250.0)
    log = MeasuredLog.read(once)
    order = [number for number in range(2) for _ in range(3)]
    steps = np.concatenate([np.arange(len(log.time))[log.episodes[n]] for n in order])
    length = len(steps) // len(order)
    noise = coloured((len(order), length), np.random.default_rng(3), sd=NOISE, memory=MEMORY).reshape(-1, 1)
    repeated = replace(
        log,
        time=log.time[steps],
        inputs=log.inputs[steps],
        outputs=log.outputs[steps] + noise,
        episode_ends=length * (1 + np.arange(len(order))),
        recording=np.zeros(len(order), dtype=int),
    )
    repeated.write(folder / "log.zarr")
    return folder / "log.zarr", task, bool(request.param)


def test_coloured_noise_is_measured_through_the_simulator(repeats):
    path, file, _ = repeats
    task = load_task(file)
    before = prepare(MeasuredLog.read(path), task)
    after, rollouts = with_noise_of_repeats(before, task.space.nominal, threads=1, seed=0)
    assert before.noise.source == after.noise.source == ("repeats",)
    assert rollouts > 0
    assert before.noise.sd[0] < 0.85 * NOISE < after.noise.sd[0] < 1.05 * NOISE


def test_coloured_noise_is_no_lack_of_fit(repeats, tmp_path, without_pages, monkeypatch):
    look_among(
        monkeypatch, "coulomb-friction", "stribeck-friction", "quadratic-drag", "sensor-bias", "control-lag"
    )
    path, task, missing = repeats
    estimate = identify(real_log=path, task=task, out=tmp_path / "estimate", threads=1, quiet=True)
    found = diagnose(
        real_log=path,
        task=task,
        estimate=tmp_path / "estimate",
        out=tmp_path / "diagnosis",
        threads=1,
        quiet=True,
    ).document
    if missing:
        assert estimate.document["verdict"] == "unexplained"
        assert found["verdict"] == "effect-found"
        assert [e["name"] for e in found["effects"]] == ["coulomb-friction"]
        assert found["parameters"] and found["effects"][0]["parameters"]["friction"][
            "value"
        ] == pytest.approx(1.5, rel=0.05)
    else:
        assert estimate.document["verdict"] == found["verdict"] == "explained"


def test_the_four_numbers_of_a_repeated_attitude_have_one_floor(tmp_path):
    path = str(gimbal(tmp_path))
    time = np.arange(500) / 250
    angle = 0.2 * np.clip(np.sin(np.pi * time) - 0.6, 0, 1)  # level, but for a moment
    true = np.tile(Rotation.from_rotvec(angle[:, None] * [1.0, 0, 0]).as_quat()[:, [3, 0, 1, 2]], (4, 1))
    noise = Rotation.from_rotvec(0.005 * np.random.default_rng(0).standard_normal((2000, 3)))
    seen = (Rotation.from_quat(true[:, [1, 2, 3, 0]]) * noise).as_quat()[:, [3, 0, 1, 2]]
    task = load_task(path)
    record(task=path, out=tmp_path / "log.zarr", episodes=4, duration=2.0, rate=250.0)
    log = MeasuredLog.read(tmp_path / "log.zarr")
    repeated = replace(
        log,
        time=np.tile(time, 4),
        inputs=np.zeros((2000, 1)),
        outputs=seen,
        episode_ends=500 * np.arange(1, 5),
    )
    before = prepare(repeated, task)
    after, _ = with_noise_of_repeats(before, task.space.nominal, threads=1, seed=0)
    error = np.sqrt(np.mean(np.square(seen - true)))
    for prepared in (before, after):
        assert prepared.noise.source == ("repeats",) * 4
        assert prepared.noise.sd == pytest.approx([error] * 4, rel=0.05)


def test_no_floor_is_below_the_sensors_steps(tmp_path, step=5e-4):
    """Repeats that ring apart at first, by less and less, until every one of them shows the same steps."""
    for name in ("model.xml", "task.toml"):
        text = (Path(SLIDER).parent / name).read_text()
        for old, new in (
            ('damping="4" stiffness="60"', 'damping="3" stiffness="4000"'),
            ('mass="2"', 'mass="1"'),
            ("high = 150.0", "high = 8000.0"),
        ):
            text = text.replace(old, new)
        (tmp_path / name).write_text(text)
    options = {"task": str(tmp_path / "task.toml"), "threads": 1}
    once = record(out=tmp_path / "once.zarr", duration=2.0, rate=250.0, **options).log
    length = len(once.time)
    four = replace(
        once,
        time=np.tile(once.time, 4),
        inputs=np.tile(once.inputs, (4, 1)),
        outputs=np.tile(once.outputs, (4, 1)),
        episode_ends=length * np.arange(1, 5),
        recording=np.zeros(4, dtype=int),
    )
    four.write(tmp_path / "four.zarr")
    kicked = {"start": {"x": (-step, step)}, "start_velocity": {"x": (-60 * step, 60 * step)}}
    log = record(
        out=tmp_path / "log.zarr", inputs_from=tmp_path / "four.zarr", seed=1, **kicked, **options
    ).log
    log = replace(log, outputs=step * np.round(log.outputs / step))
    task = load_task(options["task"])
    before = prepare(log, task)
    after, _ = with_noise_of_repeats(before, task.space.nominal, threads=1, seed=0)
    assert before.noise.source == ("repeats",) and before.noise.sd[0] > step / np.sqrt(12)
    assert after.noise.source == ("resolution",)
    assert after.noise.sd[0] == pytest.approx(step / np.sqrt(12))
