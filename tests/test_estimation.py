"""How `identify` finds its point: when a descent is over, and what is not simulated twice."""

from __future__ import annotations

import numpy as np
import pytest

from capture_cli.identifiers.base import Best
from capture_cli.protocol.model_fits import ModelFits
from capture_cli.protocol.prepare import prepare
from capture_cli.protocol.prepared_log import PreparedLog
from capture_cli.stages import estimation
from capture_cli.stages.estimation import by_physics
from capture_cli.stages.progress import Progress
from capture_cli.stages.record import record
from capture_cli.tasks import load_task


@pytest.fixture
def prepared(slider_task, tmp_path) -> PreparedLog:
    options = {"duration": 4, "rate": 100, "amplitude": {"drive": 8}, "noise": 1e-3, "threads": 1}
    made = record(
        task=str(slider_task), out=tmp_path / "log.zarr", parameters={"mass": 2.0, "damping": 3.0}, **options
    )
    return prepare(made.log, load_task(str(slider_task)), window=None, test=None, seed=0)


def found_in(prepared: PreparedLog, **options):
    start = prepared.task.space.nominal
    with Progress("identify", "round", quiet=True) as progress:
        return by_physics(ModelFits(prepared, 1), start, progress, seed=0, **{"rounds": 50, **options})


def test_a_descent_that_converged_is_not_linearized_again(prepared, monkeypatch):
    part = prepared.part(~prepared.split.is_test)
    found = found_in(prepared)
    expected = ModelFits(prepared, 1).at(part, [], found.best)
    monkeypatch.setattr(PreparedLog, "evaluate", lambda *_: pytest.fail("simulated again"))
    at = found.at
    np.testing.assert_allclose(at.at.residual, expected.at.residual, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(at.at.by_parameter, expected.at.by_parameter, rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(at.point, expected.point)


def test_one_that_was_stopped_early_is(prepared):
    found = found_in(prepared, rounds=2)
    part = prepared.part(~prepared.split.is_test)
    expected = ModelFits(prepared, 1).at(part, [], found.best)
    np.testing.assert_allclose(found.at.at.residual, expected.at.residual, rtol=1e-9, atol=1e-9)


def test_offsets_of_the_starts_are_gone_on_from(prepared):
    found = found_in(prepared)
    again = found_in(prepared, offsets=found.best.offsets)
    with_offsets, without = again.history[0].error, found.history[0].error
    assert with_offsets != without


@pytest.mark.parametrize(
    ("errors", "over"),
    [
        ([3.0, 2.0, 1.5, 1.499, 1.499], True),  # unexplained, and two rounds gained nothing to speak of
        ([2.9, 2.6, 2.4], True),  # twice as much would not do
        ([2.9, 2.6, 1.5], False),
        ([40.0, 35.0, 30.0], False),  # far off a descent is slow at first
        ([40.0, 39.8, 39.5], True),
        ([1.5, 1.5], False),  # too few to tell
        ([1.2, 1.0, 1.0, 1.0], False),  # near the noise four rounds are waited for
        ([1.2, 1.0, 1.0, 1.0, 1.0, 1.0], True),
        ([1.2, 1.002, 1.002, 1.001, 1.001, 1.0], False),
    ],
)
def test_when_a_descent_is_over(errors, over):
    history = [Best(np.zeros(1), np.zeros((1, 1)), e) for e in errors]
    assert estimation._idle(history, count=1000, unexplained_rounds=2) == over
