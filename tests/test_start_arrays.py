"""Where windows begin, as an estimate and a diagnosis have it: enough to simulate their curves from files alone."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from diagnosing import look_among
from held_inputs import held_machine
from plain_loop import imported, looped

from capture_cli.estimate.prepare import prepare
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects._scales import control_scale
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks import load_task
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.diagnose import diagnose
from capture_cli.stages.export import export
from capture_cli.stages.identify import identify
from capture_cli.stages.record import record
from capture_cli.store.diagnosis import Diagnosis
from capture_cli.store.estimate import Estimate

LOG = {"noise": 5e-4, "episodes": 4, "duration": 1.0, "rate": 250, "threads": 1}


@pytest.fixture(autouse=True)
def _without_pages(without_pages):
    """Curves are in the arrays."""


def diagnosed(folder: Path, name: str, values: list[str], monkeypatch) -> Diagnosis:
    """Of a log of the slider with the effect `name`, which is the only candidate, and is found."""
    look_among(monkeypatch, name.partition("@")[0])
    effects = [f"{name}{value}" for value in values]
    task = str(held_machine(folder / "slider", "slider", 0.004))
    record(task=task, out=folder / "log.zarr", effects=effects, **LOG)
    options = {"task": task, "starts": 1, "quiet": True, "threads": 1}
    options |= {"most_effects": 1, "expression": False}
    diagnose(real_log=folder / "log.zarr", out=folder / "d", **options)
    found = Diagnosis.read(folder / "d")
    assert [f"{e['name']}@{e['site']}" for e in found.document["effects"]] == [name]
    return found


def driven(log: MeasuredLog, steps: slice, start: float, now: float, timestep: float) -> np.ndarray:
    """Controls over the time step that begins `now`: of the model's steps since `start`, those that it is part of."""
    number, part = divmod((now - start) / timestep + 1e-9, 1)
    at = np.searchsorted(
        log.time[steps], start + timestep * np.array([number, number + 1]) + 1e-6, side="right"
    )
    before, after = log.inputs[steps][np.maximum(at - 1, 0)]
    return before + part * (after - before)


def played(folder: Path, log: MeasuredLog, arrays, window: int, told: int = 0) -> np.ndarray:
    """What the model in `folder` and the module beside it show at the times of a window, in a plain loop (step,).

    told: of how many controls before the window the module is told first.
    """
    model = mujoco.MjModel.from_xml_path(str(folder / "m.xml"))
    data = mujoco.MjData(model)
    companion = folder / "m_effects.py"
    beside = imported(companion).Effects(model) if companion.exists() else None
    begin = arrays["window/start_time"][window]
    data.qpos[:], data.qvel[:] = (arrays[f"window/start_{n}"][window] for n in ("qpos", "qvel"))
    data.time = begin - log.time[0]
    times = arrays["step/time"][arrays["step/window"] == window]
    steps = log.episodes[int(arrays["window/episode"][window])]
    clock = begin + model.opt.timestep * np.arange(2 + (times[-1] - begin) / model.opt.timestep)
    tape = (driven(log, steps, times[0], now, model.opt.timestep) for now in clock)
    if told:
        # what docs/effects.md says of a start inside a log
        first, hidden = log.time[steps][0], arrays["window/start_hidden"][window]
        for now in begin - model.opt.timestep * np.arange(told, 0, -1):
            ctrl = driven(log, steps, times[0], now, model.opt.timestep)
            beside.step(
                model, mujoco.MjData(model), ctrl + (now < first - 1e-9) * hidden * control_scale(model, 0)
            )
    sensors = looped(model, data, beside, tape)
    return np.interp(times, clock, sensors[:, 0])


@pytest.mark.parametrize(("name", "values"), [("coulomb-friction@x", ["=3"]), ("sensor-delay@q", ["=0.02"])])
def test_what_was_exported_shows_the_curves_of_the_diagnosis(tmp_path, monkeypatch, name, values):
    found = diagnosed(tmp_path, name, values, monkeypatch)
    export(result=tmp_path / "d", out=tmp_path / "m.xml")
    arrays, log = found.arrays, MeasuredLog.read(tmp_path / "log.zarr")
    # where an episode begins, what drove a late machine before is a state of its own, which a plain loop does not have
    plain = np.flatnonzero((arrays["window/start_hidden"] == 0).all(axis=1))
    assert len(plain) >= len(arrays["window/first"]) / 2
    for window in plain:
        own = arrays["step/window"] == window
        again = played(tmp_path, log, arrays, window)
        np.testing.assert_allclose(again, arrays["step/after"][own, 0], atol=1e-6)
    late = log.time[arrays["window/first"]] - arrays["window/start_time"]
    assert late == pytest.approx(0.02 if "delay" in name else 0.0, abs=2e-3)


def test_a_module_that_was_told_the_controls_before_a_window_shows_its_curves(tmp_path, monkeypatch):
    found = diagnosed(tmp_path, "control-lag@drive", ["=0.02"], monkeypatch)
    export(result=tmp_path / "d", out=tmp_path / "m.xml")
    arrays, log = found.arrays, MeasuredLog.read(tmp_path / "log.zarr")
    assert (arrays["window/start_hidden"] != 0).any()
    errors = []
    for window in range(len(arrays["window/first"])):
        after = arrays["step/after"][arrays["step/window"] == window, 0]
        told, untold = (played(tmp_path, log, arrays, window, told=steps) for steps in (400, 0))
        np.testing.assert_allclose(told, after, atol=1e-6)
        errors.append(np.abs(untold - after).max())
    assert max(errors) > 1e-4


def test_hidden_states_are_there_too(tmp_path, monkeypatch):
    found = diagnosed(tmp_path, "sensor-low-pass@q", ["=0.05"], monkeypatch)
    (effect,), arrays, task = (
        found.document["effects"],
        found.arrays,
        load_task(str(tmp_path / "slider" / "task.toml")),
    )
    assert arrays["window/start_hidden"].shape[1] == len(effect["states"]) > 0
    windows = prepare(MeasuredLog.read(tmp_path / "log.zarr"), task).windows
    simulator = Simulator(
        task, [(effect["name"], REGISTRY.get(effect["name"])(task.model, effect["site"]))], 1
    )
    point = [p["value"] for p in [*found.document["parameters"].values(), *effect["parameters"].values()]]
    initial = InitialStates(*(arrays[f"window/start_{n}"] for n in ("qpos", "qvel", "act", "time")))
    own = np.zeros((len(windows), 2 * task.model.nv + task.model.na))
    corrections = np.concatenate([own, arrays["window/start_hidden"]], axis=1)
    again = simulator.simulate(windows, initial, np.array(point), corrections[None]).outputs[0][windows.mask]
    np.testing.assert_allclose(again, arrays["step/after"], atol=1e-9)
    assert np.abs(arrays["window/start_hidden"]).max() > 0


def test_what_was_identified_shows_the_curves_of_the_estimate(tmp_path):
    task = str(held_machine(tmp_path / "slider", "slider", 0.004))
    record(task=task, out=tmp_path / "log.zarr", **LOG)
    identify(real_log=tmp_path / "log.zarr", task=task, out=tmp_path / "e", quiet=True, threads=1)
    export(result=tmp_path / "e", out=tmp_path / "m.xml")
    arrays, log = Estimate.read(tmp_path / "e").arrays, MeasuredLog.read(tmp_path / "log.zarr")
    for window in range(len(arrays["window/first"])):
        own = arrays["step/window"] == window
        again = played(tmp_path, log, arrays, window)
        np.testing.assert_allclose(again, arrays["step/simulated"][own, 0], atol=1e-6)
