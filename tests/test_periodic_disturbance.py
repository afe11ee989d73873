"""A force that repeats with time, in logs of several recordings: its phase holds within one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from held_inputs import held_machine
from machines import machine

from capture_cli.common.progress import Progress
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.split import NewSplit
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.effects.base import Recordings, SeenLog
from capture_cli.model.effects.periodic_disturbance import PeriodicDisturbance
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks import load_task
from capture_cli.select.candidates import all_candidates
from capture_cli.select.explain import Settings
from capture_cli.select.search import attribution
from capture_cli.simulate.engine import Engine, Keep
from capture_cli.stages.diagnose import diagnose_prepared
from capture_cli.stages.record import record

EFFECT = "periodic-disturbance@x"
SIZE, FREQUENCY = 1.5, 2.29
DAY = 86_411.0


@pytest.fixture(autouse=True)
def few_candidates(monkeypatch):
    """A search among a few effects is a fast one."""
    few = ("periodic-disturbance", "viscous-damping", "coulomb-friction")
    whole = all_candidates
    monkeypatch.setattr(
        attribution, "all_candidates", lambda log: [c for c in whole(log) if c.placed.kind in few]
    )


def task_in(folder: Path) -> Path:
    """The slider's task there."""
    task = folder / "slider" / "task.toml"
    return task if task.exists() else held_machine(task.parent, "slider", 0.004)


def recorded(
    folder: Path, turns: float, *, began: float = 0.0, size: float = SIZE, more: Sequence[str] = (), **options
) -> MeasuredLog:
    """A recording of the slider in which the force is `turns` ahead when its clock shows `began`, s."""
    ahead = 2 * np.pi * turns
    planted = {"sine": size * np.cos(ahead), "cosine": size * np.sin(ahead), "frequency": FREQUENCY}
    path = folder / f"{turns:.6f}.zarr"
    log = record(
        task=str(task_in(folder)),
        out=path,
        effects=[*(f"{EFFECT}.{name}={value}" for name, value in planted.items()), *more],
        noise=5e-4,
        rate=250,
        **{"episodes": 2, "duration": 2.0, "seed": round(100 * turns)} | options,
    ).log
    return replace(log, time=log.time + began, path=path)


def ready(logs: Sequence[MeasuredLog], test: str | None = "none", window: float | None = None) -> PreparedLog:
    log, task = logs[0], load_task(str(task_in(logs[0].path.parent)))
    for other in logs[1:]:
        log = log.followed_by(other)
    return prepare(log, task, window=window, split=NewSplit(test))


def diagnosed(prepared: PreparedLog) -> dict:
    """diagnosis.json."""
    settings = Settings(expression=False, threads=1)
    progress = Progress("diagnose", "model", quiet=True)
    return diagnose_prepared(prepared, prepared.task.space.nominal, settings, progress).document


def check_found(document: dict, turns: float, began: float) -> None:
    """The force is, and nothing else, so many `turns` ahead when its time began."""
    [found] = document["effects"]
    sizes = {name: (p["value"], p["sd"]) for name, p in found["parameters"].items()}
    ahead = 2 * np.pi * turns
    true = {"sine": SIZE * np.cos(ahead), "cosine": SIZE * np.sin(ahead), "frequency": FREQUENCY}
    assert found["name"] == "periodic-disturbance" and found["first_time"] == began
    assert all(abs(value - true[name]) < 4 * sd for name, (value, sd) in sizes.items())


def test_what_is_common_is_found_where_clocks_are_not(tmp_path):
    logs = [recorded(tmp_path, 0.1), recorded(tmp_path, 0.7, episodes=3)]
    document = diagnosed(ready(logs))
    check_found(document, 0.7, began=0.0)
    assert document["stages"][-1]["select"]["normalized"] < 1.1
    document = diagnosed(ready(logs, test=logs[1].recording_names[0]))
    check_found(document, 0.1, began=0.0)  # what is held out is not what phases count from
    assert document["after"]["test"]["normalized"] < 1.1 < 5 < document["before"]["test"]["normalized"]


def test_the_phase_is_not_carried_over_a_day(tmp_path):
    """A force that went on all the time, and still nobody knows how many turns it made."""
    turns = (0.1 + FREQUENCY * DAY) % 1
    logs = [recorded(tmp_path, 0.1), recorded(tmp_path, turns, began=DAY, episodes=3)]
    document = diagnosed(ready(logs))
    check_found(document, turns, began=DAY)
    assert document["effects"][0]["parameters"]["frequency"]["sd"] > 1e-4


def test_a_recording_that_a_fold_did_not_see_is_judged_with_a_phase_of_its_own(tmp_path):
    """Of three windows, each a recording, each is judged by a fit to the others."""
    logs = [recorded(tmp_path, t, episodes=1, duration=2 + t / 4) for t in (0.2, 0.45, 0.9)]
    document = diagnosed(ready(logs, window=2.0))
    check_found(document, 0.9, began=0.0)
    assert document["stages"][-1]["select"]["normalized"] < 1.1


def test_free_phases_explain_no_friction(tmp_path):
    logs = [recorded(tmp_path, t, size=0.0, more=["coulomb-friction@x=0.8"]) for t in (0.3, 0.6)]
    [found] = diagnosed(ready(logs))["effects"]
    assert found["name"] == "coulomb-friction"
    quiet = [recorded(tmp_path, t, size=0.0) for t in (0.35, 0.65)]
    assert not diagnosed(ready(quiet))["effects"]


# --- its phase ---

STEPS = 300  # of each of two recordings, of which the second is the reference, 1000 s on
FIRST = np.array([0, 120, STEPS, STEPS + 120])
VALUES = np.array([0.9, -0.4, FREQUENCY])


@pytest.fixture
def in_a_log() -> PeriodicDisturbance:
    model = machine("slider")
    effect = PeriodicDisturbance(model, "x")
    within = model.opt.timestep * np.arange(STEPS)
    recordings = Recordings(np.repeat([0, 1], STEPS), np.concatenate([within, 1000 + within]), 1)
    effect.look_in(SeenLog(window=0.5, longest=2.0, logged=frozenset([0]), seen={}, recordings=recordings))
    return effect


def moved(
    effect: PeriodicDisturbance, time: np.ndarray, turns: np.ndarray | None = None, **log
) -> np.ndarray:
    """Positions (simulation, step) of simulations that begin at rest at `time` (simulation,), s.

    turns (simulation,): by which the force is ahead of VALUES, by its amplitudes.
    """
    model, count = effect.model, len(time)
    values = np.repeat(VALUES[None], count, axis=0)
    if turns is not None:
        wave = (VALUES[0] + 1j * VALUES[1]) * np.exp(2j * np.pi * turns)
        values[:, :2] = np.stack([wave.real, wave.imag], axis=1)
    still = InitialStates(*(np.zeros((count, n)) for n in (model.nq, model.nv, model.na)), time)
    return (
        Engine(model, 1)
        .rollout(
            initial=still,
            controls=np.zeros((count, 100, model.nu)),
            forces=[effect.force(values, model.opt.timestep, **log)],
            keep=Keep(states=True),
        )
        .qpos[..., 0]
    )


def test_time_counts_from_the_beginning_of_the_reference(in_a_log):
    """As it does in an exported model that begins there with time 0; elsewhere the window's own phase is added."""
    plain, clocks = PeriodicDisturbance(in_a_log.model, "x"), in_a_log.recordings.time[FIRST]
    assert in_a_log.first_step() == STEPS
    own = np.array([0.0, 0.3, 0.0, 0.0])
    there = moved(in_a_log, clocks, states=own[:, None], first=FIRST)
    within = np.where(FIRST < STEPS, 0.0, clocks - 1000)
    np.testing.assert_allclose(there, moved(plain, within, own), rtol=0, atol=1e-12)
    assert np.abs(there).max() > 1e-4


def test_states_are_free_outside_the_reference_alone(in_a_log):
    assert in_a_log.states_sd(FIRST).ravel().tolist() == [True, True, False, False]
    assert in_a_log.fitted_to(FIRST) is in_a_log
    assert in_a_log.fitted_to(FIRST[:2]).states_sd(FIRST).all()
    one = PeriodicDisturbance(in_a_log.model, "x")
    same = replace(in_a_log.recordings, of_step=np.zeros(2 * STEPS, dtype=int))
    one.look_in(SeenLog(window=0.5, longest=2.0, logged=frozenset([0]), seen={}, recordings=same))
    assert not one.states and not len(one.states_tried)
    assert one.states_sd(FIRST).shape == (4, 0)


def test_a_score_takes_the_waves_of_a_recording_together(in_a_log):
    """From windows that begin with the same phase, to windows that go on from each other."""
    time = in_a_log.model.opt.timestep * np.arange(50)
    turns = FREQUENCY * (in_a_log.recordings.time[FIRST] - in_a_log.began(FIRST))
    begins = np.where(FIRST < STEPS, 0.0, turns)[:, None]  # in the reference they go on as they are

    def waves(turns):
        phase = 2 * np.pi * (turns + FREQUENCY * time)
        return np.stack([np.sin(phase), np.cos(phase)], axis=-1)

    columns = in_a_log.by_recording(waves(begins), VALUES, FIRST)
    np.testing.assert_allclose(columns[2:, :, :2], waves(turns[:, None])[2:])
    np.testing.assert_allclose(columns[:2, :, 2:], waves(turns[:, None])[:2])
    assert not columns[:2, :, :2].any() and not columns[2:, :, 2:].any()
