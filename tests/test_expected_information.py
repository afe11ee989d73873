"""What a proposal says an episode will add: the formula, and what `identify --resume` makes of that very episode."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_cli.estimate.initial_states.from_outputs import model_initial_states
from capture_cli.estimate.noise.noise_floor import NoiseFloor
from capture_cli.estimate.solve.linearization import Data, Linearization
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.model.tasks import load_task
from capture_cli.select.experiment.expected_information import SETTINGS as EXPECTED_INFORMATION
from capture_cli.select.experiment.expected_information import Axes, Sensitivities, information
from capture_cli.stages.excitation.drive import Drive
from capture_cli.stages.excitation.planned_episodes import Known, planned
from capture_cli.stages.identify import identify
from capture_cli.stages.import_log import import_log
from capture_cli.stages.propose import propose
from capture_cli.stages.record import record

SPACE = ParameterSpace([Parameter(n, "1", 0.0, 2.0, 0.5) for n in "abc"])
SWING_XML = """\
<mujoco model="swing">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="link">
      <joint name="hinge" type="hinge" axis="0 1 0" damping="0.05" frictionloss="0.05"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.015" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge"/></actuator>
  <sensor><jointpos name="angle" joint="hinge"/></sensor>
</mujoco>
"""
PARAMETERS = {
    "mass": ("body:link:mass", 0.2, 1.5, "kg"),
    "damping": ("joint:hinge:damping", 0.0, 0.5, "N m s/rad"),
    "friction": ("joint:hinge:frictionloss", 0.0, 0.5, "N m"),
}
MARGIN = 1.7  # of a standard deviation, up or down


def swing(folder: Path, window: float | None) -> str:
    """The task.toml of a pendulum that its motor can drive over the top."""
    (folder / "model.xml").write_text(SWING_XML)
    lines = ["format = 1", 'name = "swing"', 'model = "model.xml"']
    for name, (target, low, high, unit) in PARAMETERS.items():
        lines += [f"[parameters.{name}]", f'set = "{target}"', f"low = {low}", f"high = {high}"]
        lines.append(f'unit = "{unit}"')
    lines += ["[inputs.motor]", 'column = "u"', 'unit = "N m"', "[outputs.angle]", 'column = "y"']
    lines += ['unit = "rad"', "[log]", 'time = "t_s"']
    lines += [] if window is None else [f"window = {window}"]
    (folder / "task.toml").write_text("\n".join(lines))
    return str(folder / "task.toml")


def linearization(by_parameter: np.ndarray) -> Linearization:
    """Of windows whose initial states are known, in units of the noise; by_parameter (window, row, axis)."""
    windows, rows, axes = by_parameter.shape
    silent = np.zeros((windows, rows, 1))
    data = Data(SPACE, silent, silent == 0, np.ones(1), np.zeros((windows, 0)))
    return Linearization(
        data,
        np.full(axes, 0.5),
        np.zeros((windows, 0)),
        np.zeros((windows, rows)),
        by_parameter,
        np.zeros((windows, rows, 0)),
    )


@given(
    k=st.floats(1.0, 10.0),
    sd=st.lists(st.floats(1e-4, 0.5), min_size=3, max_size=3),
    correlation=st.floats(-0.9, 0.9),
)
@settings(max_examples=50, deadline=None)
def test_the_gain_of_a_linear_experiment_is_that_of_the_formula(k, sd, correlation):
    """log det(1 + C J'J / k) / 2, and what is left is inv(inv(C) + J'J / k), however well all was known."""
    correlated = np.eye(3)
    correlated[0, 1] = correlated[1, 0] = correlation
    covariance = correlated * np.outer(sd, sd)
    jacobian = np.random.default_rng(0).normal(size=(6, 3)) / np.array(sd)
    axes = Axes.of(SPACE, covariance)
    assert axes.step.min() >= 0.999 * SPACE.steps.min()
    assert axes.step.max() <= EXPECTED_INFORMATION.largest_step
    along = (jacobian * SPACE.span) @ (axes.directions * axes.sd)
    told = linearization(along.reshape(2, 3, 3))
    nothing = linearization(np.zeros((2, 3, 3)))
    precision = Sensitivities(told, nothing, np.zeros(2, bool)).precision(np.ones(2, bool), k)
    gain, left = information(precision)
    scale = np.outer(sd, sd)
    both = np.eye(3) + covariance @ jacobian.T @ jacobian / k
    assert gain == pytest.approx(np.linalg.slogdet(both)[1] / 2, rel=1e-6)
    after = axes.covariance(left) * np.outer(SPACE.span, SPACE.span)
    assert after / scale == pytest.approx(np.linalg.inv(both) @ covariance / scale, abs=1e-6)


def test_points_to_either_side_stay_in_the_cube_and_apart():
    axes = Axes.of(SPACE, np.diag([0.1, 1e-3, 1e-12]))
    for x in (np.zeros(3), np.ones(3), np.array([0.5, 0.0, 1.0])):
        points = axes.points(x)
        assert points.min() >= 0 and points.max() <= 1
        assert points[1:4] - points[4:] == pytest.approx(2 * (axes.directions * axes.step).T)


def test_outputs_that_jump_tell_nothing():
    """Jumps at a point and to either side of it have nothing in common; a curve, however steep, has."""
    here, up, down = np.random.default_rng(0).normal(scale=100.0, size=(3, 4, 200, 3))

    def gain(slope, bend):
        told = Sensitivities(linearization(slope), linearization(bend), np.zeros(4, bool))
        return information(told.precision(np.ones(4, bool), 1.0))[0]

    assert gain(up, np.zeros_like(up)) > 20
    assert gain((up - down) / 2, (up + down) / 2 - here) == pytest.approx(0, abs=1e-9)
    assert gain(up, 0.1 * up) == pytest.approx(gain(up, 0 * up), rel=0.01)


def test_what_diverges_is_not_among_the_episodes(tmp_path):
    task = load_task(swing(tmp_path, 0.5))
    time = 0.004 * np.arange(200)
    inputs = np.concatenate([peak * np.sin(3 * time) for peak in (1e15, 1.0, 1e15, 0.5)])[:, None]
    ends = len(time) * (1 + np.arange(4))
    driven = Drive(np.tile(time, 4), inputs, ends, model_initial_states(task.model, 4).states)
    known = Known(
        point=task.space.nominal,
        covariance=np.diag([1e-4, 1e-4, 1e-4]),
        noise=NoiseFloor(np.array([1e-3]), ("declared",)),
        interval=0.004,
        apart=np.zeros(1),
        window=0.4,
        acted=False,
        variance=1.0,
        correlated=0.0,
    )
    prepared, sound = planned(task, driven, known, threads=1)
    assert sound.tolist() == [1, 3]
    assert prepared.windows.episode.tolist() == [0, 0, 1, 1]
    assert np.isfinite(prepared.initial.states.qpos).all()
    assert planned(task, driven.rows(np.array([0, 2])), known, threads=1)[0] is None


@pytest.mark.parametrize("window", [0.5, None])
def test_what_is_expected_of_an_episode_is_what_it_adds(tmp_path, without_pages, window):
    task = swing(tmp_path, window)
    log, episode, out, file = (tmp_path / n for n in ("l.zarr", "n.zarr", "e", "p.json"))
    plant = {"task": task, "parameters": {"mass": 0.7}, "noise": 0.002, "threads": 1}
    record(out=log, episodes=4, duration=3, amplitude={"motor": 1.2}, rate=200, **plant)
    options = {"real_log": log, "out": out, "test": "none", "threads": 1, "quiet": True}
    before = identify(task=task, starts=1, **options)
    proposal = propose(result=out, threads=1)
    file.write_text(json.dumps(proposal))
    record(out=episode, inputs_from=file, seed=9, **plant)
    import_log(files=[episode], task=task, out=log, append=True)
    after = identify(resume=True, **options)
    covariances = [np.asarray(e.arrays["parameter/covariance"]) for e in (before, after)]
    then, now = (np.sqrt(np.diag(c)) for c in covariances)
    expected = np.array(list(proposal["expected_sd"].values()))
    assert np.all((now / MARGIN < expected) & (expected < now * MARGIN))
    assert np.all(expected < then)
    realised = -np.diff([np.linalg.slogdet(c)[1] for c in covariances])[0] / 2
    assert realised > 0.5
    assert proposal["information"] == pytest.approx(realised, rel=0.35)
