"""How `identify` finds its point: when a descent is over, and what is not simulated twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from capture_cli.common.progress import Progress
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.base import Best
from capture_cli.model.tasks import load_task
from capture_cli.stages.identification import estimation
from capture_cli.stages.identification.estimation import Descents, Refinement, by_physics
from capture_cli.stages.record import record


@pytest.fixture
def prepared(slider_task, tmp_path) -> PreparedLog:
    options = {"duration": 4, "rate": 100, "amplitude": {"drive": 8}, "noise": 1e-3, "threads": 1}
    made = record(
        task=str(slider_task), out=tmp_path / "log.zarr", parameters={"mass": 2.0, "damping": 3.0}, **options
    )
    return prepare(made.log, load_task(str(slider_task)))


def found_in(prepared: PreparedLog, corrections: np.ndarray | None = None, rounds: int = 50):
    start = prepared.task.space.nominal
    with Progress("identify", "round", quiet=True) as progress:
        return by_physics(ModelFits(prepared, 1), start, progress, Descents(0, rounds=rounds), corrections)


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
    again = found_in(prepared, corrections=found.best.corrections)
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


WALL_XML = """
<mujoco model="cart">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <geom name="wall" type="box" size=".1 1 1" pos="1 0 0" solref="0.02 1"/>
    <body name="cart">
      <joint name="x" type="slide" axis="1 0 0" stiffness="20" damping="2"/>
      <geom type="box" size=".1 .1 .1" mass="2"/>
    </body>
  </worldbody>
  <actuator><motor name="m" joint="x" ctrlrange="-10 10"/></actuator>
  <sensor><jointpos name="x" joint="x"/></sensor>
</mujoco>
"""
WALL_TOML = """
format = 1
name = "cart"
model = "model.xml"
parameters.mass = { set = "body:cart:mass", low = 1.0, high = 5.0, unit = "kg" }
parameters.wall = { set = "geom:wall:size_x", low = 0.05, high = 0.85, unit = "m" }
inputs.m = { column = "u", unit = "N" }
outputs.x = { column = "x", unit = "m" }
log.window = 0.5
"""


def test_what_does_not_show_at_the_nominal_value_is_looked_for_where_it_does(tmp_path):
    """A cart that touches a wall which, where the model has it, it never reaches: only a little of the wall's range is
    neither out of reach nor far too near.
    """
    (tmp_path / "model.xml").write_text(WALL_XML)
    (tmp_path / "task.toml").write_text(WALL_TOML)
    task = str(tmp_path / "task.toml")

    def driven(wall: float):
        made = record(
            task=task,
            out=tmp_path / f"{wall}.zarr",
            parameters={"mass": 1.8, "wall": wall},
            noise=5e-4,
            episodes=4,
            duration=4.0,
            rate=200,
            seed=1,
            threads=1,
        )
        return made.log

    reach = float(driven(0.05).values.max())
    wall = 0.9 - 0.95 * reach
    ready = prepare(driven(wall), load_task(task))
    found = found_in(ready)
    assert found.at.at.insensitive.tolist() == [False, True]
    with Progress("identify", "round", quiet=True) as progress:
        better = Refinement(progress, seed=0).from_where_all_show(found)
    assert better.best.parameters == pytest.approx([1.8, wall], abs=0.01)
    assert better.best.error < 1.1


@pytest.mark.parametrize("error", [1.5, 2.5, 10.0])
def test_far_from_explained_an_escape_has_to_lead_far_down(prepared, error):
    found = found_in(prepared)
    stuck = replace(found, best=replace(found.best, error=error))
    at = found.at.at
    share = estimation.SETTINGS.least_gain * at.objectives(at.inflation).sum() / at.inflation
    assert share > estimation.SETTINGS.one_sd
    assert estimation._worth_of_an_escape(stuck) == (
        estimation.SETTINGS.one_sd if error < estimation.SETTINGS.clearly else share
    )
