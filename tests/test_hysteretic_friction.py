"""Friction that remembers the way: how far it is wound up where a window begins follows from what was measured."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from begun_inside import begun_inside
from hypothesis import given
from hypothesis import strategies as st
from machines import build

from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.turning_points import SETTINGS as TURNING_POINTS
from capture_cli.log.turning_points import ways_before
from capture_cli.model.effects.hysteretic_friction import Bristles, HystereticFriction
from capture_cli.model.tasks import load_task
from capture_cli.select.candidates import all_candidates
from capture_cli.stages.record import record

SLIDER = Path(__file__).parents[1] / "benchmarks" / "machines" / "slider" / "task.toml"
EFFECT = "hysteretic-friction@x"
PLANTED = (f"{EFFECT}.friction=6", f"{EFFECT}.distance=0.02")


def prepared_log(folder: Path, *effects: str) -> tuple[PreparedLog, np.ndarray]:
    """A log of the slider, and the true parameters, those of the effects last."""
    record(
        task=str(SLIDER),
        out=folder / "log.zarr",
        effects=effects,
        noise=3e-4,
        episodes=4,
        duration=4.0,
        rate=250.0,
        seed=3,
    )
    truth = json.loads((folder / "log.truth.json").read_text(encoding="utf-8"))
    values = np.array([*truth["parameters"].values(), *truth["effects"].values()])
    log = MeasuredLog.read(folder / "log.zarr")
    return prepare(log, load_task(str(SLIDER))), values


def candidate(prepared: PreparedLog):
    return next(c.placed for c in all_candidates(prepared) if c.name == EFFECT)


def test_friction_that_builds_up_over_a_distance_is_found_again(tmp_path):
    prepared, truth = prepared_log(tmp_path, *PLANTED)
    effect, fits = candidate(prepared), ModelFits(prepared, 1)
    begin = np.array([*prepared.task.space.nominal, *effect.effect.space.nominal])
    begin[-2] = 1.0
    fit = fits.fit(prepared, [effect], begin)
    assert fit.error < 1.1
    np.testing.assert_allclose(fit.point[-2:], truth[-2:], rtol=0.05)


def test_what_was_before_a_window_is_followed_through_what_was_measured(tmp_path):
    prepared, truth = prepared_log(tmp_path, *PLANTED)
    placed = candidate(prepared)
    followed = ModelFits(prepared, 1).fit(prepared, [placed], truth).error
    placed.effect._wound = lambda given, begins: np.zeros(len(begins.first))
    assert followed < 1.1 < 2 < ModelFits(prepared, 1).fit(prepared, [placed], truth).error


def test_a_joint_that_nothing_measures_has_no_such_friction(tmp_path):
    prepared, _ = prepared_log(tmp_path)
    assert any(c.name == EFFECT for c in all_candidates(prepared))
    blind = replace(prepared, initial=replace(prepared.initial, reported=None))
    assert not any(c.name == EFFECT for c in all_candidates(blind))


# to a nanometre: turns within 1e-289 m add up to nothing
paths = st.lists(st.floats(-1, 1), min_size=2, max_size=40).map(lambda path: np.round(path, 9))


@given(paths, st.floats(0.001, 0.5))
def test_bristles_are_wound_up_by_the_ways_as_by_every_step(path, distance):
    end = len(path) - 1
    ways = ways_before(path, [slice(0, len(path))], np.array([end]), 0.0)[0]
    by_ways, by_steps = (Bristles(friction=np.ones(1), distance=distance, timestep=0.0) for _ in range(2))
    for way in ways:
        by_ways.move(way)
    for step in np.diff(path):
        by_steps.move(step)
    turns = np.count_nonzero(np.diff(np.sign(np.diff(path))))
    if turns < TURNING_POINTS.remembered:
        assert by_ways.wound == pytest.approx(by_steps.wound, abs=1e-9)
        assert ways.sum() == pytest.approx(path[-1] - path[0], abs=1e-9)
    assert abs(by_ways.wound) <= 1


def test_noise_is_no_turning_back_and_gaps_are_passed_over():
    there_and_back = np.concatenate([np.linspace(0, 1, 200), np.linspace(1, 0.4, 120)[1:]])
    noisy = there_and_back + 0.002 * np.random.default_rng(0).standard_normal(len(there_and_back))
    noisy[::3] = np.nan
    steps = np.array([150, len(noisy) - 2])
    ways = ways_before(noisy, [slice(0, len(noisy))], steps, 0.016)
    assert np.count_nonzero(ways[0]) == 1 and np.count_nonzero(ways[1]) == 2
    np.testing.assert_allclose(ways[1, -2:], [1.0, -0.6], atol=0.02)


def test_every_episode_begins_anew_and_steps_may_come_in_any_order():
    path = np.array([0.0, 1.0, 0.5, 3.0, 2.0, 5.0])
    episodes = [slice(0, 3), slice(3, 6)]
    ways = ways_before(path, episodes, np.array([5, 2, 3, 1]), 0.0)
    assert [w[w != 0].tolist() for w in ways] == [[-1.0, 3.0], [1.0, -0.5], [], [1.0]]


RIG = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody>
    <body><joint name="x" type="slide" axis="1 0 0" damping="3"/><geom size=".1" mass="1"/></body>
  </worldbody>
  <actuator><motor name="drive" joint="x"/></actuator>
  <sensor><jointpos name="x" joint="x"/></sensor>
</mujoco>
"""


def rig() -> tuple[HystereticFriction, np.ndarray]:
    """Friction at a slide, and controls (step,) under which it goes to and fro."""
    time = 0.002 * np.arange(2000)
    return HystereticFriction(build(RIG), "x"), 6 * np.sin(5 * time) + 4 * np.sin(13 * time)


def test_a_log_that_begins_wound_up_is_followed_from_there_until_that_is_forgotten():
    effect, tape = rig()
    values, cut = np.array([3.0, 0.05]), [slice(700, 2000)]
    states = np.array([[0.0, -1.0], [0.0, 0.0], [0.0, 1.0]])
    log, begun = begun_inside(effect, values, tape, [700] * 3, stretches=cut, states=states)
    away = np.abs(begun - log[0]).max(axis=1)
    assert away.argmin() != 1 and away[1] > 1e-3
    far = [1700] * 3
    log, begun = begun_inside(effect, values, tape, far, stretches=cut, states=states)
    np.testing.assert_allclose(begun, log, atol=1e-3)
    assert effect.states_sd(np.array([700, 1900])).tolist() == [[True, True], [True, False]]


@pytest.mark.parametrize("late", [0, 7], ids=["in time", "late"])
def test_a_simulation_that_begins_inside_a_log_goes_on_as_the_log_did(late):
    effect, tape = rig()
    log, begun = begun_inside(effect, np.array([3.0, 0.05]), tape, [0, 300, 1000, 1777], late=late)
    np.testing.assert_allclose(begun, log, atol=1e-9)
