"""What `diagnose` proposes where effects are tied."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from capture_cli.estimate.fit import Fit
from capture_cli.estimate.initial_states.from_outputs import model_initial_states
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.solve.base import Best
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.base import JointMotion, SeenLog
from capture_cli.model.effects.placed import Placed
from capture_cli.model.tasks import load_task
from capture_cli.select.experiment import next_experiment as menu
from capture_cli.select.experiment.excitation_range import ExcitationRange
from capture_cli.select.experiment.next_experiment import SETTINGS as NEXT_EXPERIMENT
from capture_cli.select.experiment.next_experiment import (
    driven_motion,
    driven_windows,
    next_experiment,
)
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.propose import propose
from capture_cli.stages.record import record

SLIDER = Path(__file__).parents[1] / "benchmarks" / "machines" / "slider" / "task.toml"


@pytest.fixture
def fits(tmp_path) -> ModelFits:
    return fits_of(SLIDER, tmp_path / "log.zarr")


def fits_of(task: Path, out: Path) -> ModelFits:
    """Fits to a log of the machine of a task.toml."""
    log = record(task=str(task), out=out, noise=5e-4, duration=2.0, rate=100).log
    return ModelFits(prepare(log, load_task(str(task))), 1)


def shown_in(fits: ModelFits) -> ExcitationRange:
    """What the log of `fits` shows, in which all was measured."""
    log, windows = fits.prepared.log, fits.prepared.windows
    number = np.repeat(np.arange(len(windows)), windows.samples)
    return ExcitationRange.of(
        fits.prepared.task,
        fits.prepared.noise.sd,
        time=log.time,
        window=number,
        measured=log.outputs,
        simulated=log.outputs,
    )


def with_effect(fits: ModelFits, name: str, value: float) -> Fit:
    """The nominal model with an effect of one parameter at its joint."""
    effect = REGISTRY.get(name)(fits.prepared.task.model, "x")
    point, prepared = np.append(fits.prepared.task.space.nominal, value), fits.prepared
    return fits.at(prepared, [Placed(name, effect)], Best(point, np.zeros_like(prepared.initial.sd), 0.0))


def test_an_experiment_that_tells_two_effects_apart_is_found_and_what_it_took_is_counted(fits):
    mine, other = (with_effect(fits, *e) for e in (("coulomb-friction", 1.0), ("cubic-stiffness", 50.0)))
    before = fits.rollouts
    found = next_experiment(fits, mine, [other], seed=0, shown=shown_in(fits))
    assert found["separation"] > 3
    assert found["text"].startswith("to tell it from cubic-stiffness@x: drive from rest")
    assert fits.rollouts - before == 2 * len(NEXT_EXPERIMENT.bands) * len(NEXT_EXPERIMENT.shares)


def test_an_experiment_that_takes_the_machine_near_its_log_is_taken_before_one_that_tells_more(fits):
    """The nearest rival is the farther from it, the harder the carriage is pushed."""
    mine, other = (with_effect(fits, *e) for e in (("coulomb-friction", 1.0), ("cubic-stiffness", 50.0)))
    shown = shown_in(fits)
    near, rate = (replace(shown, near=scale * shown.near) for scale in (0.2, [[1.0], [1e-6]]))
    found = next_experiment(fits, mine, [other], seed=0, shown=near)
    assert found["is_near"] and "; predicted to stay near what the log shows;" in found["text"]
    low, high = found["predicted"]["q"]["range"]
    assert near.near[0, 0] <= low < high <= near.near[0, 1]
    beyond = found["beyond_log"]
    assert not beyond["is_near"] and beyond["separation"] > found["separation"]
    assert max(beyond["peaks"]) > max(found["peaks"])
    assert "it does not stay near what the log shows: it would take" in beyond["text"]
    mildest = next_experiment(fits, mine, [other], seed=0, shown=rate)
    assert not mildest["is_near"] and max(mildest["peaks"]) < max(found["peaks"])
    assert "none that was tried stays near what the log shows: it would take" in mildest["text"]
    assert "one that goes farther would (propose --beyond-log)" in mildest["text"]


def test_an_experiment_does_not_begin_where_the_log_did(fits):
    """A spring that crept after the joint to where the log has it first would pull there."""
    task = fits.prepared.task
    spring = REGISTRY.get("viscoelastic-spring")(task.model, "x")
    time = 0.01 * np.arange(200)
    path = 0.3 + 0.05 * np.sin(5 * time)
    seen = JointMotion(0.25, 0.35, 0.25, path, [slice(0, 200)], 0.0, time)
    spring.look_in(SeenLog(window=1.0, longest=2.0, logged=frozenset({0}), seen={spring.joint: seen}))
    windows = driven_windows(task, time, np.zeros((1, 200, len(task.inputs))))
    point = np.append(task.space.nominal, [120.0, 0.3])  # N/m, s
    initial = model_initial_states(task.model, 1).states
    simulated = fits.simulator([Placed("spring", spring)]).simulate(windows, initial, point[None])
    assert np.abs(simulated.outputs).max() < 1e-4, "it is at rest, and nothing drives it"


def test_what_runs_away_does_not_hide_where_the_machine_begins(fits, tmp_path):
    """A range is asked for from where the model initial states on, and of the strongest drives one may run away."""
    model = (SLIDER.parent / "model.xml").read_text().replace('ctrlrange="-30 30"', "")
    begin = '<keyframe><key qpos="0.9"/></keyframe></mujoco>'
    (tmp_path / "model.xml").write_text(model.replace("</mujoco>", begin))
    (tmp_path / "task.toml").write_text(SLIDER.read_text())
    task = load_task(str(tmp_path / "task.toml"))
    tapes = np.zeros((2, 50, len(task.inputs)))
    tapes[0, 1:] = 1e30
    windows = driven_windows(task, 0.01 * np.arange(50), tapes)
    outputs, qpos, diverged = driven_motion(Simulator(task, threads=1), windows, task.space.nominal)
    assert diverged.tolist() == [True, False]
    assert (outputs[0] == 0.9).all() and (qpos[0] == 0.9).all()
    assert shown_in(fits).predicted(outputs, qpos, 0.01).begin[0] == 0.9


def test_nothing_tells_a_model_from_itself(fits):
    same = with_effect(fits, "coulomb-friction", 1.0)
    shown = shown_in(fits)
    assert "one and the same" in next_experiment(fits, same, [same], seed=0, shown=shown)["text"]
    assert next_experiment(fits, same, [], seed=0, shown=shown) is None


def diagnosis_of(folder: Path, fits: ModelFits, experiment) -> None:
    """The diagnosis, in `folder`, of a slider that has coulomb friction, with `experiment` as its next."""
    document = {"format": "capture/diagnosis", "version": 1, "verdict": "tied", "log": {"path": "log.zarr"}}
    nominal = fits.prepared.task.space.to_dict(fits.prepared.task.space.nominal)
    document |= {"task": fits.prepared.task.name, "parameters": {n: {"value": v} for n, v in nominal.items()}}
    friction = {
        "name": "coulomb-friction",
        "site": "x",
        "parameters": {"friction": {"value": 1.0, "high": 9.0}},
    }
    document |= {"effects": [friction], "next_experiment": experiment}
    (folder / "diagnosis.json").write_text(json.dumps(document))
    provenance = {"inputs": {}, "options": {"task": str(fits.prepared.task.path)}}
    (folder / "provenance.json").write_text(
        json.dumps({"format": "capture/provenance", "version": 1, **provenance})
    )


def test_of_a_diagnosis_what_goes_beyond_the_log_is_asked_for_and_other_peaks_are_predicted(fits, tmp_path):
    mine, other = (with_effect(fits, *e) for e in (("coulomb-friction", 1.0), ("cubic-stiffness", 50.0)))
    shown = shown_in(fits)
    found = next_experiment(fits, mine, [other], seed=0, shown=replace(shown, near=0.2 * shown.near))
    diagnosis_of(tmp_path, fits, found)
    proposal = propose(result=tmp_path, threads=1)
    assert proposal["is_near"] and proposal["predicted"] == found["predicted"]
    farther = propose(result=tmp_path, beyond_log=True, threads=1)
    assert farther["text"] == found["beyond_log"]["text"] and not farther["is_near"]
    asked = {"drive": max(found["beyond_log"]["peaks"])}
    driven = propose(result=tmp_path, amplitude=asked, threads=1)
    assert not driven["is_near"] and "as told, it does not stay near what the log shows" in driven["text"]
    # of a model that the rival has no part in
    alone = next_experiment(fits, mine, [mine], seed=0, shown=shown)
    diagnosis_of(tmp_path, fits, alone)
    again = propose(result=tmp_path, amplitude={"drive": max(alone["peaks"])}, threads=1)
    assert again["predicted"]["q"]["range"] == pytest.approx(alone["predicted"]["q"]["range"])


def test_what_is_proposed_is_what_was_judged(tmp_path, monkeypatch):
    """From rest, with the phases of the diagnosis' seed, and sampled no closer than a machine of long steps."""
    shutil.copytree(SLIDER.parent, tmp_path / "machine")
    model = tmp_path / "machine" / "model.xml"
    model.write_text(model.read_text().replace('timestep="0.002"', 'timestep="0.006"'))
    task = tmp_path / "machine" / "task.toml"
    fits = fits_of(task, tmp_path / "log.zarr")
    judged = []
    monkeypatch.setattr(menu, "driven_windows", lambda *a: judged.append(a[1:]) or driven_windows(*a))
    mine, other = (with_effect(fits, *e) for e in (("coulomb-friction", 1.0), ("cubic-stiffness", 50.0)))
    found = next_experiment(fits, mine, [other], seed=5, shown=shown_in(fits))
    diagnosis_of(tmp_path, fits, found)
    proposal = propose(result=tmp_path, seed=1)
    choices = [(list(band), share) for band in NEXT_EXPERIMENT.bands for share in NEXT_EXPERIMENT.shares]
    share = max(found["peaks"]) / np.abs(fits.prepared.log.inputs).max()
    time, tapes = judged[0]
    tape = tapes[choices.index((found["band_hz"], min(NEXT_EXPERIMENT.shares, key=lambda s: abs(s - share))))]
    assert np.array_equal(proposal["time_s"], time) and np.diff(time) == pytest.approx(0.006)
    assert np.array_equal(proposal["inputs"]["drive"], tape[:, 0]) and tape[0, 0] == 0
