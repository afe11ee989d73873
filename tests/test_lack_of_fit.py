"""What is left beyond the noise: of all outputs together, and of each."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from capture_cli.errors import LogError
from capture_cli.estimate.noise.lack_of_fit import by_chance, lack_held_out, lack_of_fit
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.solve.linearization import Data, Linearization
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.parameters import ParameterSpace
from capture_cli.model.tasks import load_task
from capture_cli.stages.record import record

ARM = Path(__file__).parents[1] / "benchmarks" / "machines" / "arm" / "task.toml"


def left(*errors: float, attitudes=(), windows=10, steps=100, seed=0) -> tuple[Data, np.ndarray]:
    """White residuals of outputs, each so many times its noise floor."""
    shape = (windows, steps, len(errors))
    noise = np.random.default_rng(seed).standard_normal(shape)
    noise *= np.array(errors) / np.sqrt(np.square(noise).mean(axis=(0, 1)))
    data = Data(
        ParameterSpace([]),
        np.zeros(shape),
        np.ones(shape, dtype=bool),
        np.ones(len(errors)),
        np.zeros((windows, 0)),
        attitudes=attitudes,
    )
    return data, noise.reshape(windows, steps * len(errors))


def of_a_fit(data: Data, residual: np.ndarray):
    none = np.zeros((*residual.shape, 0))
    return lack_of_fit(Linearization(data, np.zeros(0), np.zeros((10, 0)), residual, none, none))


def test_one_output_that_is_wrong_among_many_that_are_right_is_lacking():
    found = of_a_fit(*left(1, 1, 1, 1.5, 1, 1, 1))
    assert found.normalized < found.threshold
    assert found.lacking and found.beyond == 3 and not found.is_near
    assert found.outputs == pytest.approx([1, 1, 1, 1.5, 1, 1, 1])
    assert lack_held_out(*left(1, 1, 1, 1.5, 1, 1, 1)).lacking


def test_outputs_at_the_floor_lack_nothing():
    found = of_a_fit(*left(1.05, 1.0, 1.1))
    assert not found.lacking and found.beyond is None and found.is_near
    assert not lack_held_out(*left(1.2, 1.0, 1.25)).lacking


def test_the_numbers_of_an_attitude_are_judged_together():
    """Near level one of the four has next to no noise, and the others more than their floor."""
    four = (0.1, 1.15, 1.15, 1.16)
    found = of_a_fit(*left(*four, 1.0, attitudes=[np.arange(4)]))
    assert found.outputs[:4] == pytest.approx(np.sqrt(np.mean(np.square(four))))
    assert of_a_fit(*left(0.1, 1.6, 1.6, 1.6, 1.0, attitudes=[np.arange(4)])).lacking


def test_what_was_held_out_of_nothing_lacks_nothing():
    data, residual = left(1.0)
    assert not lack_held_out(data.rows(np.arange(0)), residual[:0]).lacking


def test_the_largest_of_several_errors_may_be_larger_by_chance():
    assert by_chance(100) < by_chance(100, of=7)
    # p = 0.00135, of seven 0.00019: quantiles of the normal distribution
    assert (by_chance(1e12, of=7) ** 2 - 1) / (by_chance(1e12) ** 2 - 1) == pytest.approx(
        3.551 / 3.0, abs=2e-3
    )


@pytest.mark.parametrize("always", [0.25, 0.3, -1e-9, 0.0])
def test_an_output_that_never_changes_is_refused(tmp_path, always):
    record(task=str(ARM), out=tmp_path / "log.zarr", noise=1e-3, episodes=3, duration=2.0, seed=0)
    log, task = MeasuredLog.read(tmp_path / "log.zarr"), load_task(str(ARM))
    log.outputs[:, 1] = (
        always  # the mean of many numbers that are not sums of powers of two is not quite them
    )
    with pytest.raises(LogError, match=f"output 'q2' never changes: always {always:.6g} rad") as error:
        prepare(log, task)
    assert "noise_sd" in error.value.cure
    known = [replace(c, noise_sd=1e-3) if c.name == "q2" else c for c in task.outputs]
    task.outputs = known
    assert prepare(log, task).noise.sd[1] == 1e-3
