"""Machines that record drives by inputs: what drives them, and where they begin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from capture_cli.errors import OptionError
from capture_cli.stages.record import record
from capture_cli.stores.measured_log import MeasuredLog


@pytest.fixture
def driven(slider_task, tmp_path) -> MeasuredLog:
    """A log of the slider, two episodes of 2 s."""
    options = {"duration": 2.0, "rate": 100.0, "amplitude": {"drive": 3.0}, "threads": 1}
    return record(task=str(slider_task), out=tmp_path / "driven.zarr", episodes=2, **options).log


def replayed(log: MeasuredLog, task: Path, folder: Path) -> MeasuredLog:
    """What the machine does under the inputs of `log`."""
    log.write(folder / "source.zarr")
    return record(
        task=str(task), out=folder / "again.zarr", inputs_from=folder / "source.zarr", threads=1
    ).log


def test_a_log_with_a_gap_is_not_replayed(driven, slider_task, tmp_path):
    time = driven.time.copy()
    time[301:402] += 0.75  # in the second episode, which begins at step 201
    with pytest.raises(
        OptionError, match=r"source\.zarr: episode 1 has a gap of 0\.76 s after 0\.99 s"
    ) as caught:
        replayed(replace(driven, time=time), slider_task, tmp_path)
    assert "[log] episode" in caught.value.cure
    assert not (tmp_path / "again.zarr").exists()


def test_samples_of_two_loggers_side_by_side_are_no_gaps(driven, slider_task, tmp_path):
    """Each sees the other 0.1 ms later, a hundredth of its own interval."""
    time = driven.time[:200].copy()
    time[1::2] = time[:-1:2] + 1e-4
    outputs = driven.outputs[: len(time)].copy()
    outputs[1::2] = np.nan
    log = replace(
        driven,
        time=time,
        inputs=driven.inputs[: len(time)],
        outputs=outputs,
        episode_ends=np.array([len(time)]),
        recording=np.zeros(1, dtype=int),
        sparse=frozenset({"q"}),
    )
    assert np.array_equal(replayed(log, slider_task, tmp_path).time, time)
