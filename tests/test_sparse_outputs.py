"""Outputs at their own rates: what a slow sensor's samples say is neither more nor less for the empty rows between."""

from __future__ import annotations

import contextlib
import json
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from diagnosing import look_among
from held_inputs import hold
from inspecting import inspect
from slow_sensors import EVERY, MACHINES, jittered, regular, thinned, with_sparse

from capture_cli.cli import main
from capture_cli.context.histories.action_library import LogWindows, sequence_task
from capture_cli.errors import LogError
from capture_cli.estimate.noise.autocorrelation import (
    autocorrelation_time,
    autocovariance,
    correlation_samples,
    correlation_steps,
)
from capture_cli.estimate.noise.noise_floor import noise_floor
from capture_cli.estimate.prepare import prepare
from capture_cli.log.arrays import Log
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks import load_task
from capture_cli.report.curves import Curves
from capture_cli.stages import diagnose as diagnose_stage
from capture_cli.stages import identify as identify_stage
from capture_cli.stages.import_log import import_log
from capture_cli.stages.record import record
from capture_cli.store.estimate import Estimate


def cart_pole(folder: Path, choose, seed: int, **options) -> tuple[Path, Path, dict]:
    """A log in which a camera sees the pole, its task.toml, and the truth."""
    task = with_sparse(folder / "task", "cart_pole", "pole")
    hold(task, 0.005)
    defaults = {"random_parameters": True, "noise": {"cart": 5e-4, "pole": 1e-3}, "episodes": 4, "threads": 1}
    made = record(
        task=str(task),
        out=folder / "whole.zarr",
        duration=3.0,
        rate=100,
        seed=seed,
        **{**defaults, **options},
    )
    thinned(made.log, "pole", choose, seed).write(folder / "log.zarr")
    return folder / "log.zarr", task, made.truth


# --- statistics ---


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_correlation_is_counted_in_an_outputs_own_samples(memory):
    """The residual of a sensor at a quarter of the steps, and the same numbers one after the other."""
    generator = np.random.default_rng(0)
    own = generator.standard_normal((6, 50, 1))
    for k in range(1, own.shape[1]):
        own[:, k] += memory * own[:, k - 1]
    spread, mask = np.zeros((6, 200, 1)), np.zeros((6, 200, 1), dtype=bool)
    spread[:, ::EVERY], mask[:, ::EVERY] = own, True
    apart, together = (spread, mask), (own, np.ones(own.shape, dtype=bool))
    np.testing.assert_allclose(autocovariance(*apart)[:50], autocovariance(*together))
    assert autocorrelation_time(*apart) == pytest.approx(autocorrelation_time(*together))
    assert correlation_samples(*apart) == pytest.approx(correlation_samples(*together))
    fast = generator.standard_normal((6, 200, 1))
    both = np.concatenate([1e-6 * fast, spread], axis=2), np.concatenate([np.ones_like(mask), mask], axis=2)
    assert correlation_steps(*both) == pytest.approx(EVERY * correlation_samples(*together), rel=1e-3)


def test_pairs_are_those_of_every_window():
    generator = np.random.default_rng(1)
    mask = generator.random((5, 30, 2)) < 0.4
    residual = generator.standard_normal(mask.shape)
    found = autocovariance(residual, mask)
    for output in range(2):
        series = [r[m] for r, m in zip(residual[..., output], mask[..., output], strict=True)]
        for lag in range(6):
            products = np.concatenate([s[lag:] * s[: len(s) - lag] for s in series])
            assert found[lag, output] == pytest.approx(products.mean())


@pytest.mark.parametrize("choose", [regular, jittered])
def test_noise_of_a_slow_sensor_is_that_of_its_samples(choose):
    generator = np.random.default_rng(2)
    time = np.tile(np.arange(1200) * 0.01, 3)
    episodes = [slice(0, 1200), slice(1200, 2400), slice(2400, 3600)]
    smooth = np.sin(2 * time + np.repeat([0, 1, 2], 1200))
    outputs = np.stack([smooth, smooth], axis=1) + [1e-3, 5e-3] * generator.standard_normal((3600, 2))
    sampled = np.ones(outputs.shape, dtype=bool)
    sampled[:, 1] = np.isin(
        np.arange(3600), np.concatenate([e.start + choose(1200, generator) for e in episodes])
    )
    drive = [np.full((1200, 1), float(k)) for k in range(3)]
    log = Log(time, np.where(sampled, outputs, 1e9), episodes, sampled=sampled)
    found = noise_floor(log, [None, None], driven_by=drive, block=50)
    assert found.sd == pytest.approx([1e-3, 5e-3], rel=0.12)
    assert found.source == ("differences", "differences")
    alike = np.sin(2 * time)[:, None] + [1e-3, 5e-3] * generator.standard_normal((3600, 2))
    sampled[:, 1] = np.arange(3600) % EVERY == 1
    log = Log(time, np.where(sampled, alike, 1e9), episodes, sampled=sampled)
    found = noise_floor(log, [None, None], driven_by=[np.zeros((1200, 1))] * 3, block=50)
    assert found.sd == pytest.approx([1e-3, 5e-3], rel=0.12)
    assert found.source == ("repeats", "repeats")


# --- fits ---


def test_rows_between_samples_change_nothing_where_inputs_are_held(tmp_path, without_pages):
    """A log of 25 Hz, and the same with three rows between in which the inputs are held and nothing was measured."""
    task = with_sparse(tmp_path / "task", "slider", "q", window="0.48")
    slow = record(
        task=str(task),
        out=tmp_path / "slow.zarr",
        noise=3e-4,
        episodes=3,
        duration=3.8,
        rate=25,
        seed=3,
        threads=1,
    ).log
    longer = [EVERY * (e.stop - e.start - 1) + 1 for e in slow.episodes]
    fast = [_filled(slow, e) for e in slow.episodes]
    replace(
        slow,
        time=np.concatenate([f[0] for f in fast]),
        inputs=np.concatenate([f[1] for f in fast]),
        outputs=np.concatenate([f[2] for f in fast]),
        episode_ends=np.cumsum(longer),
        sparse=frozenset({"q"}),
    ).write(tmp_path / "fast.zarr")
    found = [
        identify_stage.identify(
            real_log=tmp_path / f"{name}.zarr",
            task=str(task),
            out=tmp_path / name,
            test="none",
            starts=1,
            threads=1,
            quiet=True,
        ).document
        for name in ("slow", "fast")
    ]
    for name, parameter in found[0]["parameters"].items():
        for key in ("value", "sd"):
            assert found[1]["parameters"][name][key] == pytest.approx(parameter[key], rel=1e-3), (name, key)
    assert found[1]["verdict"] == found[0]["verdict"]
    for key in ("noise_floor", "lack_of_fit"):
        for name, value in found[0][key].items():
            assert found[1][key][name] == pytest.approx(value, rel=1e-3), (key, name)
    for key in ("rmse", "mae", "normalized"):
        assert found[1]["error"]["fit"][key] == pytest.approx(found[0]["error"]["fit"][key], rel=1e-3), key


def _filled(log: MeasuredLog, episode: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, inputs and outputs of an episode with EVERY - 1 rows between its own."""
    time, inputs, outputs = (a[episode] for a in (log.time, log.inputs, log.outputs))
    steps = np.arange(EVERY * (len(time) - 1) + 1)
    between = np.full((len(steps), outputs.shape[1]), np.nan)
    between[::EVERY] = outputs
    return np.interp(steps, EVERY * np.arange(len(time)), time), inputs[steps // EVERY], between


def test_parameters_are_recovered_by_a_slow_camera_and_nothing_is_found(tmp_path, without_pages):
    log, task, truth = cart_pole(tmp_path, jittered, 1)
    found = identify_stage.identify(
        real_log=log, task=str(task), out=tmp_path / "e", starts=1, threads=1, quiet=True
    ).document
    assert found["verdict"] == "explained"
    for name, p in found["parameters"].items():
        assert abs(p["value"] - truth["parameters"][name]) < 4 * p["sd"], name
        assert p["sd"] < 0.01 * (p["high"] - p["low"]), name
    assert found["noise_floor"] == pytest.approx(truth["noise_sd"], rel=0.25)
    diagnosis = diagnose_stage.diagnose(
        real_log=log, estimate=tmp_path / "e", out=tmp_path / "d", threads=1, quiet=True
    ).document
    assert (diagnosis["verdict"], diagnosis["effects"]) == ("explained", [])


def test_what_is_missing_is_found_by_a_slow_camera(tmp_path, monkeypatch, without_pages):
    look_among(
        monkeypatch, "sensor-delay", "sensor-low-pass", "control-delay", "coulomb-friction", "quadratic-drag"
    )
    log, task, _ = cart_pole(tmp_path, jittered, 1, effects=["sensor-delay@pole=0.04"], episodes=3)
    found = diagnose_stage.diagnose(
        real_log=log, task=str(task), out=tmp_path / "d", threads=1, quiet=True
    ).document
    assert [f"{e['name']}@{e['site']}" for e in found["effects"]] == ["sensor-delay@pole"]
    assert found["effects"][0]["parameters"]["delay"]["value"] == pytest.approx(0.04, rel=0.03)
    assert found["after"]["test"]["normalized"] < 1.15 < 2 < found["before"]["test"]["normalized"]


# --- from files to pages ---


def merged(log: MeasuredLog, path: Path, choose, after: tuple[float, float]) -> None:
    """Rows of encoder and camera, each at times of its own, as topics are merged: what was commanded is in all.

    The camera has a row `after` a share of the interval from those steps of the encoder that `choose` gives.
    """
    generator = np.random.default_rng(4)
    rows = []
    for number, episode in enumerate(log.episodes):
        time, force = log.time[episode], log.inputs[episode, 0]
        x, theta = log.outputs[episode].T
        steps = np.arange(len(time))
        seen = choose(len(time) - 1, generator)
        late = seen + generator.uniform(*after, len(seen))
        rows += [(number, t, u, v, "") for t, u, v in zip(time, force, x, strict=True)]
        at, angle = np.interp(late, steps, time), np.interp(late, steps, theta)
        rows += [(number, t, u, "", v) for t, u, v in zip(at, force[seen], angle, strict=True)]
    rows.sort(key=lambda row: row[:2])
    lines = [",".join(map(str, row)) for row in rows]
    path.write_text("\n".join(["episode,t_s,force_N,x_m,theta_rad", *lines]) + "\n")


def at_every_step(steps: int, _: np.random.Generator) -> np.ndarray:
    return np.arange(steps)


@pytest.mark.parametrize(("choose", "after"), [(jittered, (0.1, 0.9)), (at_every_step, (0.005, 0.006))])
def test_topics_that_were_merged(tmp_path, without_pages, choose, after):
    """Also of clocks that tick together, where every second interval between rows is next to nothing."""
    task = with_sparse(tmp_path / "task", "cart_pole", "cart", "pole")
    made = record(
        task=str(task),
        out=tmp_path / "whole.zarr",
        random_parameters=True,
        episodes=4,
        duration=3.0,
        rate=250,
        seed=5,
        threads=1,
    )
    noise = [5e-4, 1e-3] * np.random.default_rng(6).standard_normal(made.log.outputs.shape)
    merged(replace(made.log, outputs=made.log.outputs + noise), tmp_path / "merged.csv", choose, after)
    log = import_log(files=[tmp_path / "merged.csv"], task=str(task), out=tmp_path / "log.zarr")
    assert log.sparse == {"cart", "pole"}
    assert (log.sampled.sum(axis=1) == 1).all()
    found = identify_stage.identify(
        real_log=tmp_path / "log.zarr",
        task=str(task),
        out=tmp_path / "e",
        starts=1,
        threads=1,
        quiet=True,
    ).document
    assert found["split"]["fit_windows"] + found["split"]["test_windows"] == 4 * 6
    document = inspect(tmp_path / "log.zarr", task=str(task))
    assert document["recordings"][0]["rate"] is None  # of its own each
    rates = {c["name"]: c["sampling"]["rate"] for c in document["channels"] if c["kind"] == "output"}
    assert rates["cart"] == pytest.approx(250, rel=1e-3)
    assert 50 < rates["pole"] < 250.25
    assert {f["severity"] for f in document["findings"]} <= {"note"}
    assert found["verdict"] == "explained"
    for name, p in found["parameters"].items():
        assert abs(p["value"] - made.truth["parameters"][name]) < 5 * p["sd"], name


PENDULUM = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="bob" pos="0 0 2">
      <joint name="ball" type="ball" damping="0.02"/>
      <geom type="capsule" fromto="0 0 0 .1 0 -.5" size=".02" mass="1"/>
    </body>
  </worldbody>
  <sensor><ballquat name="attitude" joint="ball"/></sensor>
</mujoco>
"""
SEEN = """
format = 1
name = "pendulum"
model = "model.xml"
[parameters.damping]
set = "joint:ball:damping"
low = 0.0
high = 0.1
unit = "N m s/rad"
[outputs.attitude]
column = ["w", "x", "y", "z"]
unit = "1"
sparse = true
[log]
window = 0.6
episode = "episode"
"""


@pytest.fixture
def swinging(tmp_path) -> tuple[Path, list[list]]:
    """The task of a pendulum whose attitude a camera sees, and rows (episode, time, w, x, y, z) of two episodes."""
    (tmp_path / "model.xml").write_text(PENDULUM)
    (tmp_path / "task.toml").write_text(SEEN)
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    generator, rows = np.random.default_rng(7), []
    for episode in range(2):
        data = mujoco.MjData(model)
        data.qvel = generator.uniform(-3, 3, 3)
        seen = set(jittered(400, generator).tolist())
        for step in range(400):
            values = [""] * 4
            mujoco.mj_forward(model, data)
            if step in seen:
                sign = generator.choice([-1, 1])  # a quaternion's means nothing
                values = list(sign * (data.sensordata + 1e-3 * generator.standard_normal(4)))
            rows.append([episode, f"{0.01 * step:.2f}", *values])
            mujoco.mj_step(model, data, 5)
    return tmp_path / "task.toml", rows


def test_attitudes_by_a_slow_camera(swinging, tmp_path, without_pages):
    task, rows = swinging
    csv_of(tmp_path / "run.csv", rows)
    import_log(files=[tmp_path / "run.csv"], task=str(task), out=tmp_path / "log.zarr")
    found = identify_stage.identify(
        real_log=tmp_path / "log.zarr", task=str(task), out=tmp_path / "e", threads=1, quiet=True
    ).document
    damping = found["parameters"]["damping"]
    assert found["verdict"] == "explained"
    assert damping["sd"] < 2e-3 and abs(damping["value"] - 0.02) < 4 * damping["sd"]


def test_half_an_attitude_is_refused(swinging, tmp_path):
    task, rows = swinging
    row = next(r for r in rows if r[2] != "")
    row[4] = ""
    csv_of(tmp_path / "run.csv", rows)
    with pytest.raises(LogError, match="'attitude' has some of its 4 values and not the others") as caught:
        import_log(files=[tmp_path / "run.csv"], task=str(task), out=tmp_path / "log.zarr")
    assert f"at {float(row[1]):g} s" in caught.value.message and "or none" in caught.value.cure


def csv_of(path: Path, rows: list[list]) -> None:
    lines = [",".join(map(str, row)) for row in rows]
    path.write_text("\n".join(["episode,time,w,x,y,z", *lines]) + "\n")


def half_blind(folder: Path) -> tuple[Path, Path]:
    """One episode of the cart-pole, of which the camera saw the first half."""
    task = with_sparse(folder / "task", "cart_pole", "pole")
    hold(task, 0.005)
    whole = record(
        task=str(task), out=folder / "whole.zarr", noise=5e-4, duration=6.0, rate=100, seed=0, threads=1
    ).log
    thinned(whole, "pole", lambda steps, _: np.arange(0, steps // 2, EVERY)).write(folder / "log.zarr")
    return folder / "log.zarr", task


def test_an_output_that_was_never_held_out_has_no_error_there(tmp_path, capsys, monkeypatch):
    def capture(*arguments) -> None:
        monkeypatch.setattr(sys, "argv", ["capture", *map(str, arguments)])
        with contextlib.suppress(SystemExit):
            main()

    log, task = half_blind(tmp_path)
    options = ["--real-log", log, "--task", task, "--threads", "1", "--starts", "1"]
    capture("identify", *options, "--out", tmp_path / "e")
    assert "–" in capsys.readouterr().out
    estimate = Estimate.read(tmp_path / "e")
    assert estimate.document["error"]["test"]["rmse"]["pole"] is None
    assert estimate.document["error"]["test"]["mae"]["pole"] is None
    assert estimate.document["error"]["test"]["rmse"]["cart"] < 1e-3
    assert estimate.document["error"]["test"]["normalized"] < 1.2
    sampled = np.isfinite(estimate.arrays["step/measured"])
    assert sampled[:, 0].all() and sampled[:, 1].sum() == 75
    assert np.isfinite(estimate.arrays["step/simulated"]).all()
    curves = Curves.of(estimate)
    assert len(curves.samples(1).residual) == 75
    assert curves.samples(1).interval == pytest.approx(EVERY * curves.samples(0).interval)
    page = (tmp_path / "e" / "report.html").read_text()
    assert "NaN" not in page.split("</script>")[-1]
    look_among(
        monkeypatch, "coulomb-friction", "viscous-damping", "control-delay", "sensor-delay", "sensor-bias"
    )
    capture("diagnose", *options, "--out", tmp_path / "d")
    document = json.loads((tmp_path / "d" / "diagnosis.json").read_text())
    assert document["verdict"] == "explained"
    assert document["after"]["test"]["rmse"]["pole"] is None
    capsys.readouterr()
    capture("inspect", log, "--task", task)
    assert "75 samples, 25.0 Hz" in capsys.readouterr().out


def test_a_window_far_from_every_sample_is_not_sure_of_its_start(tmp_path):
    log, task = half_blind(tmp_path)
    prepared = prepare(MeasuredLog.read(log), load_task(str(task)))
    blind = prepared.windows.time > 3.2
    angle, speed = (prepared.initial.sd[:, k] for k in (1, 3))
    assert angle[blind].min() > 10 * angle[~blind].max()
    assert speed[blind].min() > speed[~blind].max()
    assert np.isfinite(prepared.initial.sd).all()


# --- what is refused ---


def test_what_is_fitted_holds_no_sample(tmp_path):
    task = with_sparse(tmp_path / "task", "cart_pole", "pole")
    whole = record(
        task=str(task), out=tmp_path / "whole.zarr", noise=5e-4, duration=6.0, rate=100, seed=0, threads=1
    ).log
    late = thinned(whole, "pole", lambda steps, _: np.arange(steps - 40, steps))
    with pytest.raises(LogError, match="what is fitted holds no sample of pole") as caught:
        prepare(late, load_task(str(task)))
    assert "--test" in caught.value.cure


def test_a_task_that_does_not_say_so_is_refused(tmp_path):
    log, _ = half_blind(tmp_path)
    with pytest.raises(LogError, match="'pole' was imported as sparse") as caught:
        prepare(
            MeasuredLog.read(log),
            load_task(str(MACHINES / "cart_pole" / "task.toml")),
        )
    assert "sparse = true under [outputs.pole]" in caught.value.cure


def test_learned_identifiers_read_complete_trajectories(tmp_path):
    log, task = half_blind(tmp_path)
    with pytest.raises(LogError, match="pole has no sample in some rows") as caught:
        sequence_task(load_task(str(task)), LogWindows(log))
    assert "least-squares" in caught.value.cure
