"""How fast a recorded coordinate went, from which ranges of drags follow."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from capture_cli.estimate.prepare import prepare
from capture_cli.log.fastest import fastest
from capture_cli.model.tasks import load_task
from capture_cli.select.candidates import all_candidates
from capture_cli.stages.record import record

SLIDER = Path(__file__).parents[1] / "benchmarks" / "machines" / "slider" / "task.toml"
TIME = 0.01 * np.arange(200)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_path_that_begins_at_rest_is_as_fast_as_it_gets(noise):
    seen = 0.1 * np.sin(5 * TIME) ** 2 + np.random.default_rng(0).normal(0, noise, len(TIME))  # 0.5 at most
    seen[50:60] = np.nan
    assert 0.4 < fastest(seen, TIME, [slice(0, 200)], noise) < 0.51


def test_neither_noise_nor_where_another_episode_begins_is_motion():
    path = np.where(TIME < 1.0, 0.0, 5.0) + np.random.default_rng(0).normal(0, 1e-3, len(TIME))
    assert fastest(path, TIME, [slice(0, 100), slice(100, 200)], 1e-3) < 1e-3


def test_of_windows_that_begin_at_rest_ranges_follow_from_the_motion_within(tmp_path):
    out = tmp_path / "log.zarr"
    log = record(task=str(SLIDER), out=out, noise=1e-5, episodes=3, duration=0.5, rate=100, threads=1).log
    prepared = prepare(log, load_task(str(SLIDER)))
    assert len(prepared.windows) == 3
    [drag] = [c.placed.effect for c in all_candidates(prepared) if c.placed.kind == "quadratic-drag"]
    speeds = np.abs(np.diff(log.outputs[:, 0]) / np.diff(log.time))
    speeds[log.episode_ends[:-1] - 1] = 0.0
    assert drag.seen.speed == pytest.approx(speeds.max(), rel=0.1)
