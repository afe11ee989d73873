"""Errors in open loop by prediction horizon: those of a plain loop, from states that the log shows, part by part."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.prediction import SETTINGS as PREDICTION
from capture_cli.estimate.prediction import PredictingModel, prediction_errors
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.split import NewSplit
from capture_cli.model.effects.placed import Placed
from capture_cli.model.tasks import load_task
from capture_cli.select.candidates import all_candidates
from capture_cli.stages import identify as stage
from capture_cli.stages.documents.result_document import prediction_of
from capture_cli.stages.import_log import import_log
from capture_cli.stages.record import record

CART_POLE = Path(__file__).resolve().parents[1] / "benchmarks" / "machines" / "cart_pole"
TRUTH = {"mass": 1.4, "damping": 3.0}


@pytest.fixture
def prepared(slider_task, tmp_path):
    """Makes a log of the slider at TRUTH ready: episodes at 250 Hz, with next to no noise."""

    def make(name: str = "log", test: str | None = "none", window=None, **options) -> PreparedLog:
        driven = {"amplitude": {"drive": 5.0}, "parameters": TRUTH, "noise": 1e-6}
        options = {**driven, "episodes": 2, "duration": 1.5, "rate": 250.0, **options}
        log = record(task=str(slider_task), out=tmp_path / f"{name}.zarr", threads=1, **options).log
        return prepare(log, load_task(str(slider_task)), window=window, split=NewSplit(test), threads=1)

    return make


def model(
    prepared: PreparedLog, point: dict[str, float], effects=(), hidden: float | None = None
) -> PredictingModel:
    """At `point`, its windows begun as they were read off; hidden: the states of effects that they begin with."""
    states = sum(len(e.states) for _, e in effects)
    own = np.zeros_like(prepared.initial.sd)
    corrections = np.concatenate([own, np.full((len(own), states), hidden or 0.0)], axis=1)
    values = prepared.task.space.to_vector(point)
    point = np.concatenate([values, *([p.high for p in e.parameters] for _, e in effects)])
    return PredictingModel("model", tuple(effects), point, corrections)


def errors(prepared: PreparedLog, predicting: PredictingModel, threads: int = 1) -> dict:
    """The errors of one model, as result files have them."""
    found = prediction_errors(ModelFits(prepared, threads), [predicting])
    return prediction_of(prepared, found)


def by_horizon(part: dict, key: str = "normalized") -> dict[float | None, float]:
    return {row["horizon"]: row["models"]["model"][key] for row in part["horizons"]}


def plain_loop(prepared: PreparedLog, steps: slice, point: dict[str, float]) -> np.ndarray:
    """q of the slider at `point`, (step,): stepped from the first sample on, at rest, by the inputs of the log."""
    xml = prepared.task.model_path.read_text()
    for name, old in (("mass", 'mass="1.5"'), ("damping", 'damping="2"')):
        assert old in xml
        xml = xml.replace(old, f'{name}="{point[name]}"')
    own = mujoco.MjModel.from_xml_string(xml)
    data, log, q = mujoco.MjData(own), prepared.log, []
    data.qpos[0] = log.outputs[steps.start, 0]
    every = round(float(np.median(np.diff(log.time))) / own.opt.timestep)
    for step in range(steps.start, steps.stop):
        q.append(data.qpos[0])
        data.ctrl[0] = log.inputs[step, 0]
        mujoco.mj_step(own, data, every)
    return np.array(q)


def test_a_free_run_is_that_of_a_plain_loop(prepared):
    log = prepared()
    wrong = {"mass": 2.0, "damping": 1.0}
    found = errors(log, model(log, wrong))["fit"]
    apart = np.concatenate([log.log.outputs[e, 0] - plain_loop(log, e, wrong) for e in log.log.episodes])
    expected = np.sqrt(np.mean(np.square(apart)))
    assert expected > 1e-2
    assert by_horizon(found, "rmse")[None]["q"] == pytest.approx(expected, rel=3e-3)


def test_a_right_model_is_at_the_noise_and_a_wrong_one_the_farther_the_longer(prepared):
    log = prepared(noise=1e-4, episodes=3, duration=4.0)
    right, wrong = (by_horizon(errors(log, model(log, p))["fit"]) for p in (TRUTH, TRUTH | {"mass": 1.5}))
    assert [*right] == [*wrong] == [*PREDICTION.horizons, None]
    assert right[0.1] < 1.6
    assert right[0.1] < wrong[0.1] < wrong[0.5] < wrong[2.0] < wrong[None]
    assert wrong[None] > 2 * right[None]


@pytest.mark.parametrize(
    ("window", "runs"),
    [(0.5, {0.1: 16, 0.5: 16, 2.0: 4, None: 2}), (4.0, {0.1: 80, 0.5: 16, 2.0: 4, None: 2})],
)
def test_predictions_begin_all_over_the_episodes(prepared, window, runs):
    """Where windows begin; where these are long, in between."""
    log = prepared(window=window, duration=4.0)
    found = errors(log, model(log, TRUTH))["fit"]
    assert {row["horizon"]: row["runs"] for row in found["horizons"]} == runs
    assert by_horizon(found)[0.1] < 50


def test_what_is_longer_than_the_episodes_is_left_out(prepared):
    found = errors(log := prepared(), model(log, TRUTH))
    part = found["fit"]
    assert found["test"] is None
    assert [round(row["longest"], 3) for row in part["horizons"]] == [0.1, 0.5, 1.5]
    assert part["left_out"] == ["No prediction over 2 s of what was fitted: it is 1.5 s long at most."]


def test_episodes_as_long_as_a_horizon_are_told_once(prepared):
    found = errors(log := prepared(duration=2.0), model(log, TRUTH))["fit"]
    assert [row["horizon"] for row in found["horizons"]] == [0.1, 0.5, None]
    assert found["left_out"] == []


def test_what_was_held_out_is_predicted_from_its_own_first_state(prepared):
    """Of a single episode the end is held out; what came before has no say in its error."""
    log = prepared(episodes=1, duration=6.0, test=None)
    shifted = log.log.outputs.copy()
    first = log.windows.first[log.split.is_test].min()
    shifted[: first - 10] += 0.3 * np.sin(log.log.time[: first - 10, None])
    changed = replace(log, log=replace(log.log, outputs=shifted))
    before, after = (errors(p, model(p, TRUTH)) for p in (log, changed))
    assert after["test"] == before["test"]
    assert by_horizon(after["fit"])[None] > 100 * by_horizon(before["fit"])[None]
    whole = sum(found["horizons"][-1]["longest"] for found in before.values())
    assert whole == pytest.approx(6.0, abs=0.01)


def test_each_recording_is_told_in_free_run(prepared):
    log = prepared(episodes=3)
    recordings = ({"name": n, "source": "test", "sha256": None} for n in ("morning", "noon"))
    named = replace(log.log, recordings=tuple(recordings), recording=np.array([0, 1, 1]))
    found = errors(replace(log, log=named), model(log, TRUTH | {"mass": 2.0}))["fit"]
    rows = [found["recordings"][n] for n in ("morning", "noon")]
    assert [row["runs"] for row in rows] == [1, 2]
    squares = [row["runs"] * row["models"]["model"]["rmse"]["q"] ** 2 for row in rows]
    assert sum(squares) / 3 == pytest.approx(by_horizon(found, "rmse")[None]["q"] ** 2)


def test_a_run_that_diverges_is_no_number(prepared):
    log = prepared()
    found = errors(log, model(log, TRUTH | {"damping": -1e6}))["fit"]["horizons"][-1]["models"]["model"]
    assert found == {"rmse": {"q": None}, "over_floor": {"q": None}, "normalized": None, "diverged": 2}


def test_samples_that_are_far_apart_show_nothing_in_between(prepared):
    log = prepared(rate=4.0, duration=8.0, window=2.0)
    found = errors(log, model(log, TRUTH))["fit"]
    assert [row["horizon"] for row in found["horizons"]] == [0.5, 2.0, None]
    assert found["left_out"] == ["No prediction over 0.1 s of what was fitted: samples are 0.25 s apart."]


def test_errors_do_not_depend_on_the_number_of_threads(prepared):
    log = prepared(episodes=5)
    one, three = (errors(log, model(log, TRUTH | {"mass": 2.0}), threads) for threads in (1, 3))
    assert one == three


def test_what_no_sensor_shows_begins_as_the_fit_has_it(tmp_path, monkeypatch):
    """A pole that hangs from a cart, of which the cart alone is measured."""
    monkeypatch.setattr(stage, "_write_pages", lambda *_: None)
    text = (CART_POLE / "task.toml").read_text()
    (tmp_path / "model.xml").write_text((CART_POLE / "model.xml").read_text())
    pole = text[text.index("[outputs.pole]") : text.index("[log]")]
    (tmp_path / "task.toml").write_text(text.replace(pole, ""))
    task, log = str(tmp_path / "task.toml"), tmp_path / "log.zarr"
    record(task=task, out=log, noise=2e-4, episodes=4, duration=3.0, rate=100.0, threads=1)
    found = stage.identify(real_log=log, task=task, out=tmp_path / "e", starts=1, threads=1, quiet=True)
    assert found.document["verdict"] != "unexplained"
    for part in ("fit", "test"):
        rows = {row["horizon"]: row for row in found.document["prediction"][part]["horizons"]}
        assert rows[0.5]["models"]["identified"]["normalized"] < 2.0


def test_states_that_an_effect_keeps_begin_as_the_fit_has_them(prepared):
    log = prepared()
    placed = next(c.placed for c in all_candidates(log) if c.placed.effect.states)
    found = [by_horizon(errors(log, model(log, TRUTH, [Placed(*placed)], h))["fit"]) for h in (0.0, 1.0)]
    assert found[0][0.5] != found[1][0.5]


def test_so101(real_data, tmp_path):
    """The published model of a real arm, beside a plain loop over 20 s of a motion, joint by joint."""
    data = real_data / "so101"
    motion, task = tmp_path / "motion.csv", load_task(str(data / "task_arm.toml"))
    whole = (data / "trapezoidal_profile.csv").read_text().splitlines(keepends=True)
    motion.write_text("".join(whole[:1001]))
    log = import_log(files=[motion], task=str(data / "task_arm.toml"), out=tmp_path / "log.zarr")
    ready = prepare(log, task, split=NewSplit("none"), threads=1)
    nominal = dict(zip(task.space.names, task.space.nominal, strict=True))
    found = by_horizon(errors(ready, model(ready, nominal))["fit"], "rmse")[None]
    rows = list(csv.DictReader(motion.open()))
    joints = [name.removesuffix("_pos") for name in found]
    commands, measured = (
        np.array([[float(r[j + what]) for j in joints] for r in rows]) for what in ("_cmd", "_pos")
    )
    time = 1e-6 * np.array([float(row["t_us"]) for row in rows])
    own = mujoco.MjModel.from_xml_path(str(data / "so101_arm.xml"))
    there, path = mujoco.MjData(own), []
    there.qpos[:] = measured[0]
    grid = time[0] + own.opt.timestep * np.arange(int((time[-1] - time[0]) / own.opt.timestep) + 2)
    for held in np.searchsorted(time, grid + 1e-9, side="right") - 1:
        path.append(there.qpos.copy())
        there.ctrl[:] = commands[held]
        mujoco.mj_step(own, there)
    simulated = np.stack([np.interp(time, grid, q) for q in np.transpose(path)], axis=1)
    expected = np.sqrt(np.square(measured - simulated).mean(axis=0))
    assert np.degrees(expected).max() > 1.5
    assert list(found.values()) == pytest.approx(expected, rel=0.02)
