"""Machines that record drives by inputs: what drives them, and where they begin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from capture_cli.context.histories.action_library import Multisines, sequence_task
from capture_cli.errors import CaptureError, OptionError
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks import load_task
from capture_cli.simulate.multisine import SETTINGS as MULTISINE
from capture_cli.simulate.multisine import from_rest, multisine, multisine_sequence, peak
from capture_cli.stages.record import record


@pytest.fixture
def driven(slider_task, tmp_path) -> MeasuredLog:
    """A log of the slider, two episodes of 2 s."""
    options = {"duration": 2.0, "rate": 100.0, "amplitude": {"drive": 3.0}, "threads": 1}
    return record(task=str(slider_task), out=tmp_path / "driven.zarr", episodes=2, **options).log


def with_range(slider_task: Path, low: float, high: float) -> str:
    """The slider whose actuator goes from `low` to `high`."""
    model = slider_task.parent / "model.xml"
    model.write_text(
        model.read_text().replace('joint="x"/></act', f'joint="x" ctrlrange="{low} {high}"/></act')
    )
    return str(slider_task)


def replayed(log: MeasuredLog, task: Path, folder: Path) -> MeasuredLog:
    """What the machine does under the inputs of `log`."""
    log.write(folder / "source.zarr")
    return record(
        task=str(task), out=folder / "again.zarr", inputs_from=folder / "source.zarr", threads=1
    ).log


def test_a_log_with_a_gap_is_not_replayed(driven, slider_task, tmp_path):
    time = driven.time.copy()
    time[301:402] += 0.75  # in the second episode, which begins at step 201
    with pytest.raises(
        OptionError, match=r"source\.zarr: episode 1 has a gap of 0\.76 s after 0\.99 s"
    ) as caught:
        replayed(replace(driven, time=time), slider_task, tmp_path)
    assert "[log] episode" in caught.value.cure
    assert not (tmp_path / "again.zarr").exists()


def test_samples_of_two_loggers_side_by_side_are_no_gaps(driven, slider_task, tmp_path):
    """Each sees the other 0.1 ms later, a hundredth of its own interval."""
    time = driven.time[:200].copy()
    time[1::2] = time[:-1:2] + 1e-4
    outputs = driven.outputs[: len(time)].copy()
    outputs[1::2] = np.nan
    log = replace(
        driven,
        time=time,
        inputs=driven.inputs[: len(time)],
        outputs=outputs,
        episode_ends=np.array([len(time)]),
        recording=np.zeros(1, dtype=int),
        sparse=frozenset({"q"}),
    )
    assert np.array_equal(replayed(log, slider_task, tmp_path).time, time)


TIME = np.arange(0, 3, 0.01)


@pytest.mark.parametrize(
    ("low", "high", "amplitude", "reached"),
    [
        (0, 5, None, (0, 5)),
        (-5, 0, None, (-5, 0)),
        (0, 5, 2.0, (0, 2)),
        (0, 5, 9.0, (0, 5)),
        (-1, 3, None, (-1, 3)),
        (-1, 3, 2.0, (-1, 2)),
        (2, 5, None, (2, 5)),
        (2, 5, 4.0, (2, 4)),
        (-5, -2, 4.0, (-4, -2)),
    ],
)
def test_a_range_that_is_not_symmetric_is_filled_and_not_left(slider_task, low, high, amplitude, reached):
    task = load_task(with_range(slider_task, low, high))
    given = {} if amplitude is None else {"drive": amplitude}
    peaks = np.array([peak(task.model, task.inputs[0], given)])
    tape = multisine_sequence(task, TIME, peaks, MULTISINE.band, np.random.default_rng(0))
    assert (tape.min(), tape.max()) == reached
    rested = multisine_sequence(task, TIME, peaks, MULTISINE.band, np.random.default_rng(0), at_rest=True)
    assert low <= rested.min() and rested.max() <= high and np.ptp(rested) > 0.5 * np.ptp(reached)
    assert rested[0, 0] == np.clip(0, low, high)
    assert np.abs(np.diff(rested[:, 0]))[:10].max() < 0.1 * np.ptp(reached)


@pytest.mark.parametrize("high", [None, 4.0])
def test_a_symmetric_range_is_driven_to_its_peak(slider_task, high):
    task = load_task(str(slider_task) if high is None else with_range(slider_task, -high, high))
    peaks = np.array([peak(task.model, task.inputs[0], {"drive": 3.0} if high is None else {})])
    assert peaks[0] == (high or 3.0)
    signals = multisine(TIME, 1, MULTISINE.band, np.random.default_rng(0))
    plain, rested = (
        multisine_sequence(task, TIME, peaks, MULTISINE.band, np.random.default_rng(0), at_rest=r)
        for r in (False, True)
    )
    assert plain.tobytes() == (peaks * signals).tobytes()
    assert rested.tobytes() == (peaks * from_rest(TIME, signals)).tobytes()


def test_a_symmetric_range_is_not_left_however_far_an_input_is_to_go(slider_task):
    task = load_task(with_range(slider_task, -4, 4))
    tape = multisine_sequence(task, TIME, np.array([9.0]), MULTISINE.band, np.random.default_rng(0))
    wanted = 9 * multisine(TIME, 1, MULTISINE.band, np.random.default_rng(0))
    np.testing.assert_array_equal(tape, np.clip(wanted, -4, 4))
    assert tape.max() == 4 or tape.min() == -4


def test_an_actuator_that_only_pushes_is_recorded_and_taped_within_its_range(slider_task, tmp_path):
    task = with_range(slider_task, 0, 5)
    log = record(task=task, out=tmp_path / "log.zarr", duration=4, rate=100, threads=1).log
    assert (log.inputs.min(), log.inputs.max()) == (0, 5)
    tapes = sequence_task(load_task(task), window=0.5, points=5)
    inputs = tapes.library[:, -5:]
    assert inputs.min() >= 0 and 3 < inputs.max() <= 5


def test_an_amplitude_that_the_actuator_does_not_come_down_to_is_refused(slider_task, tmp_path):
    task = with_range(slider_task, 2, 5)
    with pytest.raises(OptionError, match=r"'drive' .* no further than 1 N, .* 2 to 5") as caught:
        record(task=task, out=tmp_path / "log.zarr", amplitude={"drive": 1.0}, threads=1)
    assert "more than 2" in caught.value.cure


@pytest.mark.parametrize(("low", "high", "most"), [(-4, 4, 4), (0, 5, 5), (-5, -2, 5)])
def test_an_amplitude_that_the_actuator_would_cut_off_is_refused(slider_task, tmp_path, low, high, most):
    task = with_range(slider_task, low, high)
    said = rf"--amplitude drive=-?9: its actuator's ctrlrange, {low} to {high} N, ends before that"
    with pytest.raises(OptionError, match=said) as caught:
        record(task=task, out=tmp_path / "log.zarr", amplitude={"drive": 9.0}, threads=1)
    assert f"give {most} at most" in caught.value.cure
    with pytest.raises(OptionError, match=said):
        driven = Multisines({"drive": -9.0 if low < 0 else 9.0})
        sequence_task(load_task(task), driven, window=0.5, points=5)
    assert not (tmp_path / "log.zarr").exists()
    options = {"task": task, "duration": 1, "rate": 100, "threads": 1}
    whole = record(out=tmp_path / "all.zarr", amplitude={"drive": float(most)}, **options).log
    assert np.abs(whole.inputs).max() == most


KEYED = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body><joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
      <geom size="0.1" mass="1"/></body>
    <body pos="0 0 1"><freejoint name="loose"/><geom size="0.1" mass="1"/></body>
    <body pos="0 0 2"><joint name="turret" type="ball"/><geom size="0.1" mass="1"/></body>
  </worldbody>
  <actuator><general name="drive" joint="x" dyntype="integrator" ctrlrange="-1 1"/></actuator>
  <sensor>
    <jointpos name="x" joint="x"/><jointpos name="y" joint="y"/>
    <actuatorfrc name="f" actuator="drive"/>
  </sensor>
  <keyframe>
    <key qpos="0.1 0.2 0 0 1 1 0 0 0 1 0 0 0" qvel="0.3 -0.4 0 0 0 0 0 0 0 0 0" act="0.7"/>
  </keyframe>
</mujoco>
"""
KEYED_TASK = """
format = 1
name = "keyed"
model = "model.xml"
inputs.drive = { column = "u", unit = "N/s" }
outputs.x = { column = "x", unit = "m" }
outputs.y = { column = "y", unit = "m" }
outputs.f = { column = "f", unit = "N" }
"""


@pytest.fixture
def keyed(tmp_path) -> str:
    """The task.toml of a machine that moves and pushes as it begins, as its keyframe says."""
    (tmp_path / "model.xml").write_text(KEYED)
    (tmp_path / "task.toml").write_text(KEYED_TASK)
    return str(tmp_path / "task.toml")


def test_a_machine_begins_as_its_keyframe_says(keyed, tmp_path):
    options = {"task": keyed, "duration": 1.0, "rate": 100.0, "amplitude": {"drive": 1e-9}, "threads": 1}
    log = record(out=tmp_path / "a.zarr", episodes=2, **options).log
    for steps in log.episodes:
        x, y, force = log.outputs[steps].T
        time = log.time[steps]
        np.testing.assert_allclose(force, 0.7, rtol=1e-6)
        np.testing.assert_allclose(x, 0.1 + 0.3 * time + 0.35 * time**2, atol=1e-3)
        np.testing.assert_allclose(y, 0.2 - 0.4 * time, atol=1e-6)
    given = {"start": {"y": (0.5, 0.5)}, "start_velocity": {"y": (0.0, 0.0)}}
    x, y, _ = record(out=tmp_path / "b.zarr", **given, **options).log.outputs.T
    np.testing.assert_allclose(y, 0.5, atol=1e-9)
    np.testing.assert_allclose(x, log.outputs[log.episodes[0], 0], atol=1e-9)


@pytest.mark.parametrize("option", ["start", "start_velocity"])
@pytest.mark.parametrize(("joint", "kind"), [("loose", "free"), ("turret", "ball")])
def test_one_number_is_no_start_of_a_joint_of_several_coordinates(keyed, tmp_path, option, joint, kind):
    written = f"--{option.replace('_', '-')}"
    with pytest.raises(OptionError, match=f"{written} gives joint '{joint}' .* {kind} joint") as caught:
        record(task=keyed, out=tmp_path / "a.zarr", **{option: {joint: (0.3, 0.3)}}, threads=1)
    assert "first keyframe" in caught.value.cure
    assert not (tmp_path / "a.zarr").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"effects": ["coulomb-friction@x=-5"]}, r"friction = -5 N, and it cannot be negative"),
        ({"parameters": {"mass": -1.0}}, r"--param: mass = -1 kg, and it cannot be negative"),
    ],
)
def test_what_cannot_be_negative_is_refused_before_anything_is_simulated(
    slider_task, tmp_path, options, said
):
    with pytest.raises(OptionError, match=said) as caught:
        record(
            task=slider_task,
            out=tmp_path / "log.zarr",
            duration=4,
            amplitude={"drive": 3.0},
            threads=1,
            **options,
        )
    assert caught.value.cure.startswith("choose one from")
    assert not (tmp_path / "log.zarr").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"rate": 1e6}, r"--rate 1e\+06: the model makes \d+ steps per second"),
        ({"rate": 50, "band": (1.0, 40.0)}, "--band 1 40: 50 samples per second tell nothing above 25 Hz"),
        ({"effects": ["viscous-damping@x=-50"]}, r"takes no more of it than .* its range, -2 to"),
        ({"parameters": {"mass": 0.0}}, "has 0 mass"),
    ],
)
def test_what_a_log_could_not_hold_is_refused(slider_task, tmp_path, options, said):
    """The slider's own damping is 2 N s/m: -50 would leave a log as of -2, and a truth that says -50."""
    given = {"duration": 1.0, "amplitude": {"drive": 3.0}, "threads": 1, **options}
    with pytest.raises(CaptureError, match=said) as caught:
        record(task=slider_task, out=tmp_path / "log.zarr", **given)
    if "parameters" in options:
        assert "choose from their ranges: mass = 0, and its range is" in caught.value.cure
    assert not list(tmp_path.glob("log*"))


@pytest.mark.parametrize(("delay", "doubted"), [(0.012, 0), (12.0, 1)])
def test_an_effect_beyond_its_range_is_doubted(slider_task, tmp_path, delay, doubted):
    made = record(
        task=slider_task,
        out=tmp_path / "log.zarr",
        duration=1.0,
        amplitude={"drive": 3.0},
        effects=[f"control-delay@drive={delay}"],
        threads=1,
    )
    assert len(made.doubts) == doubted
    assert all("control-delay@drive.delay = 12 s is outside the range" in doubt for doubt in made.doubts)


def test_a_log_begins_when_its_latest_sensor_reports(slider_task, tmp_path):
    """The inputs are constant, so a late sensor reports the same motion: from the start on, not one before it."""
    options = {
        "duration": 1.0,
        "amplitude": {"drive": 0.0},
        "start_velocity": {"x": (1.0, 1.0)},
        "threads": 1,
    }
    plain = record(task=slider_task, out=tmp_path / "plain.zarr", **options).log
    effects = ["sensor-delay@q=0.03"]
    late = record(task=slider_task, out=tmp_path / "late.zarr", effects=effects, **options).log
    assert np.ptp(plain.values) > 0.1
    np.testing.assert_allclose(late.values, plain.values, atol=1e-12)
