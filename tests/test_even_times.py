"""Stamps that scatter about even times are noticed, and mended on import; times that are uneven and true are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from inspecting import inspect

from capture_cli.errors import LogError
from capture_cli.log.checks.even_times import _even, jitter
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.stages.import_log import import_log

TASK = Path(__file__).resolve().parents[1] / "benchmarks" / "machines" / "slider" / "task.toml"
INTERVAL, NOISE = 4e-3, 1e-4  # s, m


def motion(time: np.ndarray) -> np.ndarray:
    """m, at times in s: 1 m/s at most."""
    return 0.1 * np.sin(9 * time) + 0.02 * np.sin(23 * time)


def stamps(off: float, n: int = 1500, lost: tuple[int, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Even times (step,), s, and stamps that are off by so many s, at most half an interval."""
    generator = np.random.default_rng(1)
    time = INTERVAL * np.delete(np.arange(n), lost)
    return time, time + np.clip(generator.normal(0, off, len(time)), -1.9e-3, 1.9e-3)


def written(path: Path, stamp: np.ndarray, values: np.ndarray) -> Path:
    noise = np.random.default_rng(2).normal(0, NOISE, len(values))
    rows = zip(stamp, np.sin(5 * stamp), values + noise, strict=True)
    lines = ["t_s,episode,force_N,q_m", *(f"{t:.7f},0,{u:.5f},{q:.7f}" for t, u, q in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def read(folder: Path, stamp: np.ndarray, values: np.ndarray, **options) -> MeasuredLog:
    file = written(folder / "log.csv", stamp, values)
    return import_log(files=[file], task=str(TASK), out=folder / "log.zarr", force=True, **options)


@pytest.mark.parametrize("off", [0.3e-3, 1e-3])
def test_stamps_that_scatter_are_noticed_and_evened(tmp_path, off):
    time, stamp = stamps(off)
    log = read(tmp_path, stamp, motion(time))
    found = jitter(log)
    assert found.sd == pytest.approx((stamp - time).std(), rel=0.02)
    here, there = found.smoother["q"]
    assert there == pytest.approx(NOISE, rel=0.1) and here > 1.25 * NOISE
    (warning,) = (f for f in inspect(tmp_path / "log.zarr")["findings"] if f["where"] == "time")
    assert warning["severity"] == "warning" and "--even-times" in warning["cure"]
    evened = read(tmp_path, stamp, motion(time), even_times=True)
    np.testing.assert_allclose(evened.time - evened.time[0], time, atol=2e-4)
    assert np.ptp(np.diff(evened.time)) < 1e-9
    assert evened.recordings[0]["evened_times"] == pytest.approx(found.sd, rel=1e-6)
    (note,) = (f for f in inspect(tmp_path / "log.zarr")["findings"] if "even times" in f["message"])
    assert note["severity"] == "note"


def test_times_that_are_uneven_and_true_are_left_alone(tmp_path):
    _, stamp = stamps(1e-3)
    assert jitter(read(tmp_path, stamp, motion(stamp))) is None
    uneven = [f["message"] for f in inspect(tmp_path / "log.zarr")["findings"] if f["severity"] == "note"]
    assert any("sampling is uneven" in m for m in uneven)


def test_even_times_and_slow_motion_say_nothing(tmp_path):
    time, stamp = stamps(1e-3)
    assert jitter(read(tmp_path, time, motion(time))) is None
    assert jitter(read(tmp_path, stamp, 0.01 * motion(time))) is None


def test_lost_samples_leave_their_place(tmp_path):
    time, stamp = stamps(0.5e-3, lost=(100, 400, 401, 900))
    np.testing.assert_allclose(_even(stamp), time, atol=2e-4)


def test_times_that_are_near_no_even_ones_are_refused(tmp_path):
    generator = np.random.default_rng(0)
    stamp = np.cumsum(generator.uniform(0.2, 2.5, 800)) * INTERVAL
    with pytest.raises(LogError, match="even intervals") as refused:
        read(tmp_path, stamp, motion(stamp), even_times=True)
    assert "--even-times" in refused.value.cure
    assert not (tmp_path / "log.zarr").exists()


def test_an_episode_too_short_to_tell_stays_as_it_is():
    _, stamp = stamps(1e-3, n=15)
    assert _even(stamp) is stamp
