"""`capture record` of a task of actions, and what `identify` makes of such a log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from capture_cli.common.extras import missing
from capture_cli.errors import LogError, OptionError
from capture_cli.estimate.initial_states.of_windows import as_acted, begins_as_acted
from capture_cli.estimate.prepare import prepare
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks import load_task
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.excitation.drive import SETTINGS as DRIVE
from capture_cli.stages.import_log import import_log
from capture_cli.stages.record import record

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hockey")
    made = record(
        task="air-hockey",
        out=folder / "log.zarr",
        parameters={"mallet_damping": -4.0, "right_friction": 0.035, "left_damping": -8.0},
        noise=0.001,
        episodes=4,
        seed=3,
        threads=1,
    )
    return folder, made


def test_actions_are_random_within_their_ranges_and_in_the_log(recorded):
    folder, made = recorded
    task = load_task("air-hockey")
    log = MeasuredLog.read(folder / "log.zarr")
    np.testing.assert_array_equal(log.actions, made.log.actions)
    assert log.actions.shape == (4, 4)
    assert np.all((log.actions >= task.actions.low) & (log.actions <= task.actions.high))
    assert len(np.unique(log.actions[:, 0])) == 4
    assert made.truth["world"] == "plant"


@pytest.mark.parametrize("policy", [None, str(ROOT / "runs" / "policies" / "air-hockey")])
def test_a_policy_that_believes_something_else_each_time_acts_differently(tmp_path, policy):
    options = {"task": "air-hockey", "policy": policy, "episodes": 3, "seed": 2, "threads": 1}
    same = record(out=tmp_path / "a.zarr", **options).log.actions
    other = record(out=tmp_path / "b.zarr", belief="random", **options).log.actions
    task = load_task("air-hockey")
    assert np.all((other >= task.actions.low) & (other <= task.actions.high))
    assert len(np.unique(other[:, 0])) == 3
    assert (len(np.unique(same[:, 0])) == 3) == (policy is None)


def test_a_log_says_whether_episodes_begin_as_acted(recorded):
    _, made = recorded
    task = load_task("air-hockey")
    prepared = prepare(made.log, task)
    assert begins_as_acted(prepared)
    first = [e.start for e in made.log.episodes]
    elsewhere = made.log.outputs.copy()
    elsewhere[first, 0] += 0.005  # m, five times the noise
    assert not begins_as_acted(prepare(replace(made.log, outputs=elsewhere), task))
    acted = as_acted(prepared)
    begins = prepared.windows.elapsed == 0
    assert (acted.initial.sd[begins] == 0).all()
    np.testing.assert_array_equal(acted.initial.sd[~begins], prepared.initial.sd[~begins])


def test_a_log_does_not_say_what_is_true(tmp_path):
    record(
        task="air-hockey",
        out=tmp_path / "log.zarr",
        parameters={"left_friction": 0.0431},
        effects=["gravity-tilt.tilt_x=0.0217"],
        threads=1,
    )
    inside = [f.read_bytes() for f in (tmp_path / "log.zarr").rglob("*") if f.is_file()]
    assert not any(word in content for content in inside for word in (b"tilt", b"0.0217", b"0.0431"))
    assert b"0.0217" in (tmp_path / "log.truth.json").read_bytes()


def test_the_log_is_sampled_at_its_rate_to_the_end_of_the_action(recorded):
    _, made = recorded
    for steps in made.log.episodes:
        np.testing.assert_allclose(np.diff(made.log.time[steps]), 1 / DRIVE.action_rate)
        assert made.log.time[steps][-1] == pytest.approx(2.0)


def test_logged_inputs_move_the_mallet_as_the_action_does(recorded):
    _, made = recorded
    task = load_task("air-hockey")
    points = np.rint(task.point_times * DRIVE.action_rate).astype(int)
    measured = np.stack([made.log.outputs[s][points] for s in made.log.episodes])
    parameters = task.space.to_vector(made.truth["parameters"])
    simulated, _ = Simulator(task).trajectories(np.tile(parameters, (4, 1)), made.log.actions)
    assert np.abs(task.observe(measured) - simulated).max() < 0.005  # noise of 1 mm


def test_episodes_start_where_their_action_says(recorded):
    folder, _ = recorded
    task = load_task("air-hockey")
    log = MeasuredLog.read(folder / "log.zarr")
    prepared = prepare(log, task, window=2.0)
    known = task.episodes(log.actions).initial
    np.testing.assert_array_equal(prepared.initial.states.qpos, known.qpos)
    np.testing.assert_array_equal(prepared.initial.states.qvel, 0)
    np.testing.assert_array_equal(prepared.initial.sd[0] > 0, [1, 1, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0])
    cut = prepare(log, task, window=0.5)  # windows that begin in mid-episode are read off the log
    assert np.all(cut.initial.sd[:, :2] > 0)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"duration": 3.0}, "--duration means nothing"),
        ({"start": {"puck_x": (0.0, 0.1)}}, "--start means nothing"),
        ({"amplitude": {"mallet_vx": 1.0}}, "--amplitude means nothing"),
        ({"duration": 0.0}, "--duration 0"),
        ({"rate": -5.0}, "--rate -5"),
        ({"policy": "nobody"}, "neither a policy nor a checkpoint"),
        ({"belief": "certain"}, "unknown --belief 'certain'"),
        ({"world": "moon"}, "unknown --world 'moon'"),
        pytest.param(
            {"world": "robosuite", "effects": ["control-lag@mallet_vx=0.1"]},
            "--effect means nothing",
            marks=pytest.mark.skipif(bool(missing("robosuite")), reason="needs the extra robosuite"),
        ),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path, options, said):
    with pytest.raises(OptionError, match=said):
        record(task="air-hockey", out=tmp_path / "log.zarr", **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("truth", ["log.zarr", "log.zarr/truth.json"])
def test_the_truth_is_not_in_the_log(tmp_path, truth):
    with pytest.raises(OptionError, match="must not find its truth"):
        record(task="scooping", out=tmp_path / "log.zarr", truth=tmp_path / truth, threads=1)
    assert not any(tmp_path.iterdir())


def test_an_episode_has_one_action(recorded, tmp_path):
    """Of a file in which it changes within one, episodes were not parted: only the first row's had been kept."""
    _, made = recorded
    task, steps = load_task("air-hockey"), made.log.episodes[0]
    channels = [made.log.inputs[steps], made.log.outputs[steps]]
    table = np.column_stack(
        [made.log.time[steps], *channels, np.tile(made.log.actions[0], (len(channels[0]), 1))]
    )
    names = [task.log.time, *(c.column for c in (*task.inputs, *task.outputs))]
    names += [f"action.{name}" for name in task.actions.names]

    def imported():
        np.savetxt(
            tmp_path / "run.csv", table, delimiter=",", header=",".join(names), comments="", fmt="%.9g"
        )
        return import_log(
            files=[tmp_path / "run.csv"], task="air-hockey", out=tmp_path / "run.zarr", force=True
        )

    np.testing.assert_allclose(imported().actions, made.log.actions[:1], rtol=1e-8)
    table[9:, -1] *= 0.5
    with pytest.raises(
        LogError, match=f"column '{names[-1]}' is .* at line 2 and .* at line 11, in one episode"
    ):
        imported()
