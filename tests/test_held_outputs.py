"""Sample-and-hold: a slow sensor's last value in every row is told from a coarse sensor, and emptied on import."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from inspecting import inspect
from slow_sensors import MACHINES, with_sparse

from capture_cli.errors import LogError
from capture_cli.log.checks.held_outputs import rows_per_sample, sample_rate, without_repeats
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks import load_task
from capture_cli.stages.identify import identify
from capture_cli.stages.import_log import import_log
from capture_cli.stages.record import record

STEPS, ROWS = 1200, 4
EPISODES = [slice(0, 500), slice(500, STEPS)]


def held(values: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Each of the values (step, ...) at `samples` (sample,) until the next."""
    return values[samples[np.searchsorted(samples, np.arange(len(values)), side="right") - 1]]


def motion(noise: float = 1e-4, speed: float = 1.0) -> np.ndarray:
    time = speed * np.arange(STEPS) / 200
    return (
        np.sin(3 * time) + 0.4 * np.sin(7.7 * time) + noise * np.random.default_rng(0).standard_normal(STEPS)
    )


# --- what is held ---


@pytest.mark.parametrize("rows", [2, 2.5, 4, 10, 33.3])
def test_each_sample_is_held_for_some_rows(rows):
    samples = np.unique(np.floor(rows * np.arange(STEPS / rows)).astype(int))
    found = rows_per_sample(held(motion(), samples), EPISODES)
    assert found == pytest.approx(rows, rel=0.03)
    assert sample_rate(np.arange(STEPS) / 200, EPISODES, found) == pytest.approx(200 / rows, rel=0.03)


def test_a_slow_sensor_of_limited_resolution_that_rests_in_between_is_held():
    values = np.where(np.arange(STEPS) % 600 < 200, 0.0, np.round(motion(), 3))
    assert rows_per_sample(held(values, np.arange(0, STEPS, ROWS)), EPISODES) == pytest.approx(ROWS)


@pytest.mark.parametrize(
    "kind", ["fast", "coarse", "ramp", "noisy and coarse", "resting", "switched", "few", "speed"]
)
def test_what_is_not_held(kind):
    time = np.arange(STEPS) / 200
    values = {
        "fast": motion(),
        "coarse": np.round(motion(0.0, 0.2), 2),
        "ramp": np.floor(time * 200 / ROWS + 1e-9) * 0.01,  # changes in every fourth row, by one step
        "noisy and coarse": np.round(motion(0.003, 0.2), 2),
        "resting": np.full(STEPS, 0.3),
        "switched": (np.arange(STEPS) % 8 < 4).astype(float),
        # one count in every fourth row, over times that are not even
        "speed": (np.arange(STEPS) % 4 == 0) / np.random.default_rng(1).uniform(0.9, 1.1, STEPS),
        "few": held(motion(), np.arange(0, STEPS, 100)),
    }[kind]
    assert rows_per_sample(values, EPISODES) is None


# --- a log in which the position is ---


def slider_log(folder: Path) -> tuple[Path, dict[str, float]]:
    """A CSV of the slider at 200 Hz, whose position comes at 50 Hz and is held; and the truth."""
    truth = {"mass": 2.2, "damping": 6.0, "stiffness": 60.0}
    made = record(
        task=str(MACHINES / "slider" / "task.toml"),
        out=folder / "whole.zarr",
        parameters=truth,
        noise=2e-4,
        episodes=3,
        duration=4.0,
        rate=200,
        seed=1,
        threads=1,
    ).log
    rows = ["t_s,force_N,q_m,episode"]
    for number, e in enumerate(made.episodes):
        q = held(made.outputs[e, 0], np.arange(0, e.stop - e.start, ROWS))
        columns = zip(made.time[e].tolist(), made.inputs[e, 0].tolist(), q.tolist(), strict=True)
        rows += [f"{t!r},{force!r},{value!r},{number}" for t, force, value in columns]
    (folder / "run.csv").write_text("\n".join(rows) + "\n")
    return folder / "run.csv", truth


@pytest.mark.usefixtures("without_pages")
def test_a_held_output_is_found_and_with_its_repeats_emptied_the_log_is_explained(tmp_path):
    file, truth = slider_log(tmp_path)
    task = MACHINES / "slider" / "task.toml"
    import_log(files=[file], task=str(task), out=tmp_path / "held.zarr")
    finding = next(
        f for f in inspect(tmp_path / "held.zarr", str(task))["findings"] if "repeats" in f["message"]
    )
    assert (finding["severity"], finding["where"]) == ("warning", "output q")
    assert "every 4 rows: 50 times per second, of 200 rows" in finding["message"]
    assert "sparse = true under [outputs.q]" in finding["cure"] and "--drop-held" in finding["cure"]
    with pytest.raises(LogError, match="--drop-held") as refused:
        import_log(files=[file], task=str(task), out=tmp_path / "no.zarr", drop_held=True)
    assert refused.value.cure == "write sparse = true under [outputs.q]"

    sparse = with_sparse(tmp_path / "sparse", "slider", "q")
    import_log(files=[file], task=str(sparse), out=tmp_path / "still.zarr")
    still = inspect(tmp_path / "still.zarr", str(sparse))["findings"]
    assert [f["cure"].startswith("import the files again with --drop-held") for f in still] == [True]
    log = import_log(files=[file], task=str(sparse), out=tmp_path / "log.zarr", drop_held=True)
    for e in log.episodes:
        assert np.array_equal(np.flatnonzero(log.sampled[e, 0]), np.arange(0, e.stop - e.start, ROWS))
    assert log.recordings[0]["held_repeats"] == (~log.sampled).sum()
    found = inspect(tmp_path / "log.zarr", str(sparse))
    assert [f["severity"] for f in found["findings"]] == ["note"]
    assert found["channels"][1]["sampling"]["rate"] == pytest.approx(50)
    document = identify(
        real_log=tmp_path / "log.zarr", task=str(sparse), out=tmp_path / "est", threads=1
    ).document
    assert document["verdict"] == "explained"
    for name, value in truth.items():
        low, high = document["parameters"][name]["ci95"]
        assert low < value < high and high - low < 0.1 * value


def test_a_run_of_which_an_episode_has_only_the_end_says_nothing_of_when_it_was_sampled(tmp_path):
    task = load_task(str(with_sparse(tmp_path, "slider", "q")))
    samples = np.r_[0, np.arange(2, STEPS, ROWS)]  # the first is of 2 rows before the first episode
    log = MeasuredLog(
        task="slider",
        time=np.arange(STEPS) / 200,
        inputs=np.zeros((STEPS, 1)),
        outputs=held(motion(), samples)[:, None],
        episode_ends=np.array([602, STEPS]),
        recording=np.array([0, 1]),
        input_names=("drive",),
        input_units=("N",),
        output_names=("q",),
        output_units=("m",),
        recordings=({"name": "a"}, {"name": "b"}),
    )
    emptied = without_repeats(log, task)
    assert np.array_equal(np.flatnonzero(emptied.sampled[:, 0]), samples[1:])
    assert sum(r["held_repeats"] for r in emptied.recordings) == (~emptied.sampled).sum()
    fast = replace(log, outputs=motion()[:, None])
    assert without_repeats(fast, task).sampled.all()


def test_what_is_in_the_log_already_keeps_its_samples_and_what_comes_may_be_a_log(tmp_path):
    file, _ = slider_log(tmp_path)
    task = with_sparse(tmp_path / "sparse", "slider", "q")
    options = {"task": str(task), "out": tmp_path / "log.zarr"}
    import_log(files=[file], **options)
    (tmp_path / "again.csv").write_text(file.read_text() + "\n")
    log = import_log(files=[tmp_path / "again.csv"], append=True, drop_held=True, **options)
    half = len(log.time) // 2
    assert log.sampled[:half].all() and not log.sampled[half:].all()
    assert [r.get("held_repeats") for r in log.recordings] == [None, (~log.sampled).sum()]
    import_log(files=[file], task=str(task), out=tmp_path / "held.zarr")
    emptied = import_log(
        files=[tmp_path / "held.zarr"], task=str(task), out=tmp_path / "e.zarr", drop_held=True
    )
    assert np.array_equal(emptied.sampled, log.sampled[half:])


def test_the_values_of_a_sensor_are_held_together(tmp_path):
    """A framepos of which x moves, y is coarse, and z never changes."""
    values = held(
        np.column_stack([motion(), np.round(motion(0.0, 0.2), 2), np.zeros(STEPS)]), np.arange(0, STEPS, ROWS)
    )
    assert rows_per_sample(values, EPISODES) == pytest.approx(ROWS)
    assert rows_per_sample(values[:, 1:], EPISODES) is None


def test_a_sensor_that_is_held_is_named_once(tmp_path):
    values = [held(motion(speed=1 + 0.1 * k), np.arange(0, STEPS, ROWS)) for k in range(4)]
    (tmp_path / "model.xml").write_text(
        '<mujoco><worldbody><body name="b"><freejoint/><geom size=".1"/></body></worldbody><sensor>'
        '<framepos name="at" objtype="body" objname="b"/><subtreecom name="com" body="b"/></sensor></mujoco>'
    )
    task = (
        'format = 1\nname = "ball"\nmodel = "model.xml"\n[outputs.at]\ncolumn = ["x", "y", "z"]\nunit = "m"\n'
        '[outputs.com]\ncolumn = ["fast_x", "fast_y", "u"]\nunit = "m"\n'
    )
    (tmp_path / "task.toml").write_text(task)
    fast = [motion(speed=1.7), motion(speed=0.6)]
    rows = np.column_stack([np.arange(STEPS) / 200, *values, *fast])
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header="time,x,y,z,u,fast_x,fast_y", comments="")
    import_log(files=[tmp_path / "run.csv"], task=str(tmp_path / "task.toml"), out=tmp_path / "log.zarr")
    found = inspect(tmp_path / "log.zarr")["findings"]
    assert [f["where"] for f in found if "repeats" in f["message"]] == ["output at", "output com_z"]
    assert not any("quantised" in f["message"] for f in found)

    (tmp_path / "task.toml").write_text(task.replace('"m"\n', '"m"\nsparse = true\n', 1))
    emptied = {"task": str(tmp_path / "task.toml"), "out": tmp_path / "sparse.zarr"}
    import_log(files=[tmp_path / "run.csv"], **emptied)
    (tmp_path / "task.toml").write_text(task)
    errors = [f for f in inspect(tmp_path / "sparse.zarr")["findings"] if f["severity"] == "error"]
    assert [(f["where"], f["cure"]) for f in errors] == [
        ("output at", "write sparse = true under [outputs.at]")
    ]
