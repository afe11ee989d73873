"""A spring that relaxes: found where it is planted, and followed through the log before a window."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from begun_inside import begun_inside
from diagnosing import diagnose, look_among
from held_inputs import held_machine
from hypothesis import given
from hypothesis import strategies as st
from machines import build
from recorded_logs import record_log
from test_hysteretic_friction import RIG

from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.effects._followed_log import measured_stretches
from capture_cli.model.effects.viscoelastic_spring import MaxwellElement, ViscoelasticSpring, followed
from capture_cli.model.tasks import load_task

EFFECT = "viscoelastic-spring@x"
STIFFNESS, RELAXATION = 120.0, 0.3  # N/m, s


def recorded(folder: Path, *planted: str) -> MeasuredLog:
    """A log of the slider."""
    task = held_machine(folder / "slider", "slider", 0.004)
    return record_log(folder, task, *planted, noise=3e-4, episodes=4, duration=4.0, seed=3)


def test_a_spring_that_relaxes_is_found_with_its_stiffness_and_its_time(tmp_path, monkeypatch):
    others = (
        "linear-stiffness",
        "viscous-damping",
        "hysteretic-friction",
        "coulomb-friction",
        "sensor-delay",
    )
    look_among(monkeypatch, EFFECT.partition("@")[0], *others)
    log = recorded(tmp_path, f"{EFFECT}.stiffness={STIFFNESS}", f"{EFFECT}.relaxation={RELAXATION}")
    document = diagnose(log, load_task(str(tmp_path / "slider" / "task.toml")), seed=0)
    assert [f"{e['name']}@{e['site']}" for e in document["effects"]] == [EFFECT]
    size = {name: p["value"] for name, p in document["effects"][0]["parameters"].items()}
    assert size == pytest.approx({"stiffness": STIFFNESS, "relaxation": RELAXATION}, rel=0.1)
    before, after = (document[when]["test"]["normalized"] for when in ("before", "after"))
    assert after < 1.2 < 2 < before


def test_behind_a_filter_it_is_found_with_its_stiffness_and_its_time(tmp_path, monkeypatch):
    """What it crept after before a window is the joint, not what the filter shows of it."""
    look_among(monkeypatch, EFFECT.partition("@")[0], "sensor-low-pass", "control-lag")
    log = recorded(
        tmp_path,
        f"{EFFECT}.stiffness={STIFFNESS}",
        f"{EFFECT}.relaxation={RELAXATION}",
        "sensor-low-pass@q.time_constant=0.02",
    )
    document = diagnose(log, load_task(str(tmp_path / "slider" / "task.toml")), seed=0)
    found = {f"{e['name']}@{e['site']}": e["parameters"] for e in document["effects"]}
    size = {name: p["value"] for name, p in found[EFFECT].items()}
    assert size == pytest.approx({"stiffness": STIFFNESS, "relaxation": RELAXATION}, rel=0.1)
    assert document["after"]["test"]["normalized"] < 1.1


@given(st.floats(0.01, 10), st.integers(1, 50), st.floats(-1, 1))
def test_a_step_of_steady_motion_is_exact_in_any_number_of_parts(relaxation, parts, way):
    whole, divided = (
        MaxwellElement(stiffness=2.0, relaxation=relaxation, timestep=0.1 / n, stretch=np.full(1, 0.3))
        for n in (1, parts)
    )
    whole(np.zeros(1))
    for position in np.linspace(0, way, parts + 1):
        force = divided(np.full(1, position))
    assert force == pytest.approx(whole(np.full(1, way)), abs=1e-9)


def test_held_at_a_place_its_force_falls_to_a_share_of_e_in_its_relaxation_time():
    spring = MaxwellElement(stiffness=np.full(1, 5.0), relaxation=0.2, timestep=0.001)
    spring(np.zeros(1))
    forces = [float(spring(np.ones(1))[0]) for _ in range(201)]
    assert forces[0] == pytest.approx(-5.0, rel=0.01)
    assert forces[200] / forces[0] == pytest.approx(np.exp(-1), rel=1e-9)


@pytest.mark.parametrize("relaxation", [0.01, 0.3, 30.0])
def test_what_creeps_after_a_path_passes_over_gaps_and_uneven_steps(relaxation):
    """A ramp from rest, of which what creeps after it is known: behind by (1 - e^(-t / relaxation)) relaxation."""
    rng = np.random.default_rng(0)
    time = 3.0 + np.sort(np.concatenate([[0.0, 2.0], rng.uniform(0, 2, 998)]))
    path = 0.7 * (time - time[0])
    path[rng.random(1000) < 0.3] = np.nan
    path[[0, -1]] = 0.0, 1.4
    elapsed = time - time[0]
    expected = 0.7 * (elapsed - relaxation * -np.expm1(-elapsed / relaxation))
    ((_, times, measured),) = measured_stretches(time, path, [slice(0, 1000)])
    np.testing.assert_allclose(followed(times, measured, relaxation), expected, atol=5e-5)


def test_a_stretch_that_nothing_measured_is_left_out_and_one_of_a_single_step_is_followed():
    time, path = np.arange(4.0), np.array([np.nan, np.nan, np.nan, 1.0])
    ((steps, times, measured),) = measured_stretches(time, path, [slice(0, 3), slice(3, 4)])
    assert steps == slice(3, 4) and followed(times, measured, 0.1).tolist() == [1.0]


def rig() -> tuple[ViscoelasticSpring, np.ndarray]:
    """A spring at a slide, and controls (step,) under which it goes to and fro."""
    time = 0.002 * np.arange(2000)
    return ViscoelasticSpring(build(RIG), "x"), 6 * np.sin(5 * time) + 4 * np.sin(13 * time)


@pytest.mark.parametrize("late", [0, 7], ids=["in time", "late"])
@pytest.mark.parametrize("relaxation", [0.02, 0.3, 2.0])
def test_a_simulation_that_begins_inside_a_log_goes_on_as_the_log_did(relaxation, late):
    effect, tape = rig()
    log, begun = begun_inside(effect, np.array([40.0, relaxation]), tape, [0, 300, 1000, 1777], late=late)
    np.testing.assert_allclose(begun, log, atol=1e-9)


def test_how_far_it_was_stretched_when_a_log_began_is_forgotten():
    effect, tape = rig()
    values, cut = np.array([40.0, 0.1]), [slice(700, 2000)]
    states = np.array([[-1.0], [0.0], [1.0]])
    log, begun = begun_inside(effect, values, tape, [700] * 3, stretches=cut, states=states)
    way = begun[2] - begun[1]
    assert np.abs(way).max() > 1e-3
    np.testing.assert_allclose(begun[0] + begun[2], 2 * begun[1], atol=1e-9)
    behind = float(way @ (log[0] - begun[1]) / (way @ way))
    np.testing.assert_allclose(begun[1] + behind * way, log[0], atol=1e-9)
    log, begun = begun_inside(effect, values, tape, [1700] * 3, stretches=cut, states=states)
    np.testing.assert_allclose(begun, log, atol=1e-5)
    slowest = effect.space.high[1]
    assert slowest == pytest.approx(2.0)
    assert effect.states_sd(np.array([700, 1900])).tolist() == [[True], [True]]
    effect.longest = 0.2
    assert effect.states_sd(np.array([700, 1900])).tolist() == [[True], [False]]
