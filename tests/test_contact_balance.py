"""The force balance of machines that touch: what hits is left out, what rests presses as hard as keeps it there."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from balances import Made

from capture_cli.errors import LogError
from capture_cli.estimate.balance.balanced_fits import declared_balance
from capture_cli.estimate.balance.force_balance import ForceBalance
from capture_cli.estimate.balance.impacts import impacts
from capture_cli.estimate.balance.motion import SmoothedLog
from capture_cli.estimate.balance.whitening import Whitening
from capture_cli.estimate.prepare import prepare
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks import load_task
from capture_cli.select.balance_scores import screening_of
from capture_cli.select.candidates import all_candidates

SHIPPED = Path(__file__).resolve().parents[1] / "datasets" / "air_hockey.zarr"
WALL_AT = 1.2 - 0.2 - 0.04  # m: its middle, half its width, and the radius of the puck
CORNER = """<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 .1"/>
    <geom name="wall" type="box" size=".1 1 .5" pos="1.1 0 0"/>
    <body pos="0 0 .1"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><geom size=".1"/></body>
  </worldbody>
</mujoco>"""


@pytest.fixture(scope="module")
def puck():
    return Made.of("puck", seed=3, episodes=6)


def test_samples_at_the_wall_are_left_out_and_the_rest_is_kept(puck):
    smoothed = puck.smoothed
    kept = np.concatenate([np.arange(p.start, p.stop) for p in smoothed.parts])
    x = puck.log.arrays.outputs[:, 0]
    assert (x[kept] < WALL_AT).all()
    assert (x > WALL_AT).any()
    assert len(kept) > 0.8 * len(x)


def test_what_presses_along_a_coordinate_that_is_measured_is_left_out_and_what_does_not_is_not():
    model = mujoco.MjModel.from_xml_string(CORNER)
    path = np.stack([np.linspace(0, 1, 101), np.zeros(101)], axis=1)
    noise, still = np.array([1e-4, 0.0]), np.zeros_like(path)
    found = impacts(model, path, noise, still)
    # the wall, within four standard deviations; never the floor, which presses along what no sensor shows
    assert np.array_equal(np.flatnonzero(found), np.flatnonzero(path[:, 0] + 0.1 > 1.0 - 4e-4))
    assert impacts(model, path, np.full(2, 1e-4), still).all()
    # what moves a tenth between samples may have been there
    assert impacts(model, path, noise, np.full_like(path, 0.1)).sum() == found.sum() + 10


def test_the_friction_of_a_table_is_found_without_a_simulation(puck):
    screening = puck.screening([])
    model = screening.fits.fitted(screening.best())
    assert model.point[0] == pytest.approx(puck.truth[0], rel=0.01)
    assert puck.experiment.task.space.nominal[0] != pytest.approx(puck.truth[0], rel=0.2)


def test_a_table_pushes_back_as_much_as_it_is_pressed(puck):
    balance, mass = puck.balance, float(puck.experiment.task.model.body("puck").mass[0])
    speed = np.hypot(*balance.state[1][:, :2].T)
    slides = (speed > 0.2) & ~balance.at_rest.any(axis=1)
    by_lift = balance.inverse_inertia[slides][:, :, 2] * mass
    along = balance.state[1][slides] / speed[slides, None]
    # lifted by its weight it feels no friction: a unit of lift takes mu of it away, and it stays where it is
    assert np.allclose((by_lift * along).sum(axis=1), puck.truth[0], rtol=0.05)
    assert np.abs(by_lift[:, 2]).max() < 1e-9


def test_no_force_of_a_coordinate_that_rests_is_asked_of_the_log(puck):
    assert puck.whitening.dofs.tolist() == [0, 1]
    logs = [Made.of("puck", seed=seed, episodes=6) for seed in range(5)]  # one has some 60 rows
    white = np.concatenate([log.white([log.balance.null]) for log in logs])
    assert 0.8 < white.std() < 1.25


def test_a_stretch_that_is_shorter_than_any_row_is_left_out():
    """Between two impacts: a few points in it do not determine a spline through it."""
    made = Made.of("cart_pole", episodes=3)
    log = made.log.arrays
    within = np.ones(len(log.time), dtype=bool)
    within[[100, 113]] = False
    smoothed = SmoothedLog.of(log, made.experiment.task, within)
    assert smoothed.every > 1
    assert not any(part.start == 101 for part in smoothed.parts)
    assert any(part.start == 114 for part in smoothed.parts)
    declared_balance(smoothed, made.experiment.task.space.nominal, 1)


def test_a_joint_that_no_sensor_shows_and_that_moves_leaves_no_balance():
    made = Made.of("cart_pole", episodes=3)
    task = made.experiment.task
    own = SmoothedLog.of(made.log.arrays, task)
    assert own.dofs.tolist() == [0, 1]
    few = copy(task)
    few.outputs = task.outputs[:1]
    with pytest.raises(LogError, match="all joints that move"):
        SmoothedLog.of(replace(made.log.arrays, outputs=made.log.arrays.outputs[:, :1]), few)


@pytest.mark.parametrize("threads", [1, 2])
def test_threads_do_not_change_a_bit(puck, threads):
    one = ForceBalance(puck.smoothed, puck.truth, threads).null.predicted
    assert np.array_equal(one, puck.balance.null.predicted)


def test_effects_of_impacts_are_left_to_simulations(puck):
    friction = {"contact-friction@table", "contact-friction@puck"}
    contacts = friction | {"contact-restitution@puck", "geom-scale@wall"}
    few = [p for p in puck.placed if p.name in contacts]
    assert puck.screening(few).covered == friction


def test_sensors_are_asked_of_simulations_too_where_bodies_hit(puck):
    """A frame that is turned bends no straight path: what shows it is where the wall is."""
    names = {"sensor-frame-rotation@x+y", "sensor-scale@x", "coulomb-friction@x"}
    few = [p for p in puck.placed if p.name in names]
    screening = puck.screening(few)
    assert {p.kind for p in few if p.name in screening.covered - screening.decided} == {
        "sensor-frame-rotation",
        "sensor-scale",
    }
    assert "coulomb-friction@x" in screening.decided
    slider = Made.of("slider", episodes=2)
    own = slider.screening([p for p in slider.placed if p.kind == "sensor-scale"])
    assert own.covered and own.decided == own.covered


def test_friction_of_a_geom_that_has_less_than_its_partner_does_nothing_at_first(puck):
    thresholds = {p.name: p.effect.has_threshold for p in puck.placed if p.kind == "contact-friction"}
    assert thresholds["contact-friction@puck"] and not thresholds["contact-friction@table"]


def test_a_log_that_is_mostly_impacts_is_smoothed_between_them_and_one_of_impacts_alone_is_not(puck):
    log, task = puck.log.arrays, puck.experiment.task
    free = log.episodes[:2]
    noise = 1e-3 * np.random.default_rng(0).standard_normal(log.outputs.shape)
    at_wall = np.array([WALL_AT, 0.0]) + noise
    between = at_wall.copy()
    for episode in free:
        between[episode] = log.outputs[episode]
    smoothed = SmoothedLog.of(replace(log, outputs=between), task)
    assert smoothed.hits and smoothed.parts
    assert all(any(e.start <= p.start and p.stop <= e.stop for e in free) for p in smoothed.parts)
    with pytest.raises(LogError, match="between impacts"):
        SmoothedLog.of(replace(log, outputs=at_wall), task)


def test_a_coordinate_that_never_moves_has_no_model_error(puck):
    whitening = Whitening(puck.balance)
    whitening.segments = [s for s in whitening.segments if s.coordinate == 0]
    left = [rows[..., 0] for rows in whitening.rows([puck.balance.null])]
    whitening.adapt(left, whitening.slow_noise)
    moves, rests = whitening.model_error
    assert moves > 0 and rests == 0


def test_what_acts_on_a_joint_that_no_sensor_shows_is_none_of_the_balance(puck):
    few = [p for p in puck.placed if p.kind in ("constant-force", "loose-mass")]
    at_height = {p.name for p in few if p.name.endswith("@z")}
    assert at_height and puck.screening(few).covered == {p.name for p in few} - at_height


def test_so_are_controls_and_what_shows_in_no_row():
    """Of a mallet that is led to a hit, and rests after it, no row is left."""
    log = MeasuredLog.read(SHIPPED)
    ready = prepare(log, load_task("air-hockey"))
    names = {"control-lag", "coulomb-friction@mallet_x", "coulomb-friction@puck_x"}
    few = [c for c in all_candidates(ready) if c.name in names]
    screening = screening_of(ready, np.ones(len(ready.windows), dtype=bool), few, 1, lambda *_: None)
    assert screening.covered == names
    assert screening.decided == {"coulomb-friction@puck_x"}
