"""Histories: what they hold, that nothing but the options decides their bytes, and that no run is lost or doubled."""

from __future__ import annotations

import errno
import json
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
import zarr
from inspecting import inspect
from setting_numbers import set_numbers
from typer.testing import CliRunner

from capture_cli.cli.app import app
from capture_cli.context.checkpoints import policy_checkpoint
from capture_cli.context.checkpoints.checkpoint_hash import checkpoint_hash
from capture_cli.context.checkpoints.policy_checkpoint import load_policy, save_policy
from capture_cli.context.histories import history_recipe
from capture_cli.context.histories.action_library import LogWindows, Multisines, sequence_task
from capture_cli.context.histories.history_recipe import Recipe
from capture_cli.context.histories.moving_parameters import check_parameters_move_trajectories
from capture_cli.context.policies.base import Policy
from capture_cli.context.policies.random import Random
from capture_cli.context.search import REGISTRY as SEARCHES
from capture_cli.errors import FitError, OptionError, OutputError, StoreError, TaskError
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks import load_task
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.gen_histories import gen_histories
from capture_cli.stages.record import record
from capture_cli.store.histories import DATA, Histories, HistoriesWriter
from capture_cli.store.output import sha256, unfinished

DRIVEN = {"drive": 3.0}
SMALL = {"pairs": 40, "rounds": 4, "shard_pairs": 16, "points": 5, "window": 0.1, "amplitude": DRIVEN}


@pytest.fixture
def generate(slider_task, tmp_path):
    """Histories of the slider at a path; its options are `SMALL` but for those given."""

    def run(name: str = "h.zarr", **options) -> str:
        out = name if "://" in name else tmp_path / name
        gen_histories(task=str(slider_task), out=out, **{**SMALL, "threads": 1, **options})
        return str(out).removeprefix("file://")

    return run


@pytest.fixture
def slider(slider_task):
    """The slider as a task of actions, as `generate` makes it."""
    return sequence_task(load_task(str(slider_task)), Multisines(DRIVEN), points=5, window=0.1)


def recipe(task, **options) -> Recipe:
    search = SEARCHES.get("randomized-binary")()
    given = {"search": search, "rounds": 4, "noise": "none", "noise_sd": (0.0,), "seed": 0, **options}
    return Recipe(task=task, policy=given.pop("policy", Random(task)), **given)


# --- what they hold ---


def test_a_history_is_what_the_simulator_gives(generate, slider):
    histories = Histories(generate())
    batch = histories.read(0, len(histories))
    assert batch["simulated"].shape == batch["measured"].shape == (40, 4, 5, 1)
    assert np.array_equal(batch["parameters"][:, -1], batch["target"])
    simulator = Simulator(slider)
    actions = batch["actions"].reshape(160, -1)
    under = {"simulated": batch["parameters"], "measured": np.repeat(batch["target"][:, None], 4, axis=1)}
    for name, parameters in under.items():
        trajectories, _ = simulator.trajectories(parameters.reshape(160, -1), actions)
        assert np.array_equal(np.float32(trajectories).reshape(40, 4, 5, 1), batch[name])
    assert np.abs(batch["simulated"] - batch["measured"])[:, 0].max() > 1e-3
    assert np.array_equal(batch["simulated"][:, -1], batch["measured"][:, -1])


def test_the_store_describes_itself(generate, slider):
    path = generate(noise_sd=0.001, seed=3, alpha=2.0)
    attributes = Histories(path).attributes
    assert attributes["task"] == "slider"
    assert [p["name"] for p in attributes["parameters"]] == ["mass", "damping"]
    assert [a["name"] for a in attributes["actions"]] == list(slider.actions.names)
    assert (attributes["alpha"], attributes["seed"], attributes["rounds"]) == (2.0, 3, 4)
    assert attributes["noise_sd"] == {"q": 0.001}
    assert attributes["features"][0]["scale"] > 0
    group = zarr.open_group(path, mode="r")
    for spec in DATA:
        assert group[spec.path].metadata.dimension_names == spec.dims
        assert group[spec.path].shards[0] == 16
    assert json.loads((Path(path) / "provenance.json").read_text())["command"] == "gen-histories"


@pytest.mark.parametrize("noise", [{"noise": "scale"}, {"noise_sd": {"q": 0.01}}])
def test_noise_changes_what_is_measured_and_nothing_else(generate, noise):
    plain, noisy = (Histories(generate(n, **o)).read(0, 40) for n, o in (("a", {}), ("b", noise)))
    for name in ("parameters", "actions", "simulated", "target"):
        assert np.array_equal(plain[name], noisy[name]), name
    difference = noisy["measured"] - plain["measured"]
    if "noise_sd" in noise:
        assert abs(difference.std() / 0.01 - 1) < 0.1
    else:
        assert 0.05 < np.abs(difference / plain["measured"]).max() <= 0.1 + 1e-4


def test_a_log_gives_the_actions(slider_task, tmp_path, generate):
    record(
        task=str(slider_task), out=tmp_path / "log.zarr", amplitude={"drive": 3.0}, duration=5.0, noise=1e-4
    )
    task = sequence_task(load_task(str(slider_task)), LogWindows(tmp_path / "log.zarr"), points=11)
    log = MeasuredLog.read(tmp_path / "log.zarr")
    assert len(task.library) >= 9
    first = task.library[:1]
    assert abs(first[0, 0] - log.outputs[0, 0]) < 1e-3
    assert abs(first[0, -1] - np.interp(task.point_times[-1], log.time, log.inputs[:, 0])) < 0.2
    # replayed under the truth, the tape gives what was logged
    trajectories, _ = Simulator(task).trajectories(task.space.nominal[None], first)
    logged = np.interp(task.point_times, log.time, log.outputs[:, 0])
    assert np.abs(trajectories[0, :, 0] - logged).max() < 0.02 * np.ptp(log.outputs)
    batch = Histories(
        generate(inputs_from=tmp_path / "log.zarr", points=11, window=None, amplitude=None)
    ).read(0, 40)
    drawn = {tuple(a) for a in batch["actions"].reshape(-1, batch["actions"].shape[-1])}
    assert drawn <= {tuple(a) for a in task.library}


# --- nothing but the options decides the bytes ---


def test_bytes_do_not_depend_on_threads_order_or_process(generate, slider_task, tmp_path):
    expected = sha256(Path(generate("a.zarr", threads=1)))
    assert sha256(Path(generate("b.zarr", threads=3))) == expected
    # shards made last to first, the last one by another process
    attributes = dict(zarr.open_group(str(tmp_path / "a.zarr"), mode="r").attrs)
    writer = HistoriesWriter(str(tmp_path / "c.zarr"))
    writer.create({k: v for k, v in attributes.items() if k not in ("format", "version", "complete")})
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as processes:
        processes.submit(make_shard, slider_task, writer, 2).result()
    for shard in (1, 0):
        make_shard(slider_task, writer, shard)
    writer.finish()
    assert sha256(tmp_path / "c.zarr") == expected


def make_shard(slider_task, writer: HistoriesWriter, shard: int) -> None:
    task = sequence_task(load_task(str(slider_task)), Multisines(DRIVEN), points=5, window=0.1)
    rows = range(40)[16 * shard : 16 * (shard + 1)]
    writer.write(shard, recipe(task).make(rows, threads=1))


def test_a_pair_is_the_same_in_any_company(generate):
    few, many = (Histories(generate(n, pairs=p)).read(0, p) for n, p in (("a", 17), ("b", 40)))
    for spec in DATA:
        assert np.array_equal(few[spec.path], many[spec.path][:17]), spec.path


def test_a_seed_of_its_own(generate):
    one, other = (Histories(generate(f"{s}.zarr", seed=s)).read(0, 40) for s in (0, 1))
    assert not np.isin(one["target"], other["target"]).any()


def test_pairs_that_diverge_are_drawn_anew(slider, monkeypatch):
    simulate = Simulator.trajectories

    def fragile(simulator, parameters, actions):
        trajectories, diverged = simulate(simulator, parameters, actions)
        return trajectories, diverged | (parameters[:, 0] > 3.0)

    whole = recipe(slider).make(range(30))
    monkeypatch.setattr(Simulator, "trajectories", fragile)
    arrays = recipe(slider).make(range(30))
    assert arrays["parameters"][..., 0].max() <= 3.0
    same = whole["parameters"][..., 0].max(axis=1) <= 3.0
    assert 0 < same.sum() < 30
    assert np.array_equal(arrays["actions"][same], whole["actions"][same])
    set_numbers(monkeypatch, history_recipe, attempts=1)
    with pytest.raises(FitError, match=r"pair \d+ diverged"):
        recipe(slider).make(range(30))


# --- runs that end early ---


def test_a_killed_run_goes_on_where_it_was(slider_task, tmp_path, generate):
    expected = sha256(Path(generate("whole.zarr", pairs=160)))
    options = {**SMALL, "task": str(slider_task), "out": str(tmp_path / "k.zarr"), "threads": 1, "pairs": 160}
    program = (
        "import time\n"
        "from capture_cli.stages.gen_histories import HistoriesWriter, gen_histories\n"
        "write = HistoriesWriter.write\n"
        "HistoriesWriter.write = lambda *a: (time.sleep(0.3), write(*a))\n"  # so that it is met at work
        f"gen_histories(**{options})"
    )
    run = subprocess.Popen([sys.executable, "-c", program])
    partial = unfinished(tmp_path / "k.zarr")
    while len(list(partial.glob("written/c/[0-9]"))) < 3:
        assert run.poll() is None
        time.sleep(0.02)
    run.send_signal(signal.SIGKILL)
    run.wait()
    assert not (tmp_path / "k.zarr").exists()
    with pytest.raises(StoreError, match=r"not finished[\s\S]*--resume"):
        Histories(partial)
    with pytest.raises(OutputError, match=r"unfinished[\s\S]*--resume"):
        generate("k.zarr", pairs=160)
    with pytest.raises(OptionError, match="rounds was 4, now 5"):
        generate("k.zarr", pairs=160, rounds=5, resume=True)
    shards = sorted(partial.glob("simulated/c/*"), key=lambda f: int(f.name))[:3]
    before = {f.name: next(f.rglob("0/0/0")).stat().st_mtime_ns for f in shards}
    assert sha256(Path(generate("k.zarr", pairs=160, resume=True))) == expected
    kept = {n: (tmp_path / "k.zarr/simulated/c" / n / "0/0/0").stat().st_mtime_ns for n in before}
    assert kept == before


class Interrupted(Exception):
    pass


@pytest.fixture
def stop_after(monkeypatch):
    """Makes `HistoriesWriter.write` fail at the shard of that number, with that error."""

    def arm(shard: int, error: BaseException) -> None:
        write = HistoriesWriter.write

        def failing(writer, number, arrays):
            if number == shard:
                raise error
            write(writer, number, arrays)

        monkeypatch.setattr(HistoriesWriter, "write", failing)

    return arm


def test_resumed_is_as_if_never_stopped(generate, stop_after, monkeypatch, tmp_path):
    expected = sha256(Path(generate("whole.zarr")))
    with monkeypatch.context():
        stop_after(2, Interrupted())
        with pytest.raises(Interrupted):
            generate()
    monkeypatch.undo()
    assert HistoriesWriter(str(unfinished(tmp_path / "h.zarr"))).is_written().tolist() == [True, True, False]
    made = []
    monkeypatch.setattr(HistoriesWriter, "write", _noting(HistoriesWriter.write, made))
    assert sha256(Path(generate(resume=True))) == expected
    assert made == [2]
    assert not unfinished(tmp_path / "h.zarr").exists()
    generate(resume=True)  # complete: nothing to do
    assert made == [2]
    with pytest.raises(OptionError, match="search was"):
        generate(resume=True, search="binary")


def _noting(write, made):
    def noting(writer, shard, arrays):
        made.append(shard)
        write(writer, shard, arrays)

    return noting


def test_a_damaged_shard_is_made_again(generate, stop_after, monkeypatch, tmp_path):
    expected = sha256(Path(generate("whole.zarr")))
    stop_after(2, Interrupted())
    with pytest.raises(Interrupted):
        generate()
    monkeypatch.undo()
    shard = unfinished(tmp_path / "h.zarr") / "simulated" / "c" / "1" / "0" / "0" / "0"
    damaged = bytearray(shard.read_bytes())
    damaged[40] ^= 0xFF
    shard.write_bytes(damaged)
    assert sha256(Path(generate(resume=True))) == expected


@pytest.mark.parametrize("half", ["written/c/2", "simulated/c/2/0/0/0", "zarr.json"])
def test_what_was_half_written_is_removed(generate, stop_after, monkeypatch, tmp_path, half):
    """Of a process that was killed between writing a file and putting it in its place."""
    expected = sha256(Path(generate("whole.zarr")))
    stop_after(2, Interrupted())
    with pytest.raises(Interrupted):
        generate()
    monkeypatch.undo()
    place = unfinished(tmp_path / "h.zarr") / half
    place.parent.mkdir(parents=True, exist_ok=True)
    with pytest.raises(KeyboardInterrupt), zarr.storage._local._atomic_write(place, "wb") as file:
        file.write(b"half")
        raise KeyboardInterrupt  # which zarr does not clean up after, as nobody does after SIGKILL
    assert list(place.parent.glob("*.partial"))
    assert sha256(Path(generate(resume=True))) == expected


def test_a_full_disk_loses_nothing(generate, stop_after, monkeypatch, tmp_path):
    stop_after(1, OSError(errno.ENOSPC, "No space left on device"))
    with pytest.raises(OutputError, match=r"disk is full[\s\S]*kept[\s\S]*--resume"):
        generate()
    monkeypatch.undo()
    assert not (tmp_path / "h.zarr").exists()
    assert len(Histories(generate(resume=True)).read(0, 40)["target"]) == 40


def test_a_run_that_fails_at_once_leaves_nothing(generate, stop_after, tmp_path):
    stop_after(0, Interrupted())
    with pytest.raises(Interrupted):
        generate()
    assert not list(tmp_path.glob("*h.zarr*"))


def test_ctrl_c_says_how_to_go_on(generate, stop_after):
    stop_after(1, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt, match=r"16 of 40 histories are kept[\s\S]*--resume"):
        generate()


@pytest.mark.parametrize(("name", "again"), [("h.zarr", ""), ("memory://interrupted/h.zarr", " and --force")])
def test_ctrl_c_before_anything_is_kept_says_how_to_begin_anew(
    generate, stop_after, monkeypatch, name, again
):
    stop_after(0, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt) as caught:
        generate(name)
    said = f"interrupted: no histories are kept\n  cure: begin anew with the same command{again}"
    assert str(caught.value) == (said if again else ""), "of a path the command line says that nothing is"
    monkeypatch.undo()
    assert len(Histories(generate(name, force=bool(again)))) == 40


def test_existing_histories_are_not_replaced_unasked(generate):
    generate()
    with pytest.raises(OutputError, match="exists already"):
        generate()
    assert len(Histories(generate(pairs=20, force=True))) == 20


def test_a_log_is_not_replaced_by_the_histories_that_read_it(generate, slider_task, tmp_path):
    log = tmp_path / "log.zarr"
    record(task=str(slider_task), out=log, duration=0.5, amplitude={"drive": 3.0}, threads=1)
    with pytest.raises(OutputError, match="which is read"):
        generate("log.zarr", inputs_from=log, amplitude=None, force=True)
    with pytest.raises(OutputError, match="which is read"):
        record(task=str(slider_task), out=log, inputs_from=log, force=True, threads=1)
    assert len(MeasuredLog.read(log).time)


def test_at_a_url(generate, slider_task, tmp_path):
    expected = Histories(generate()).read(0, 40)
    url = "memory://bucket/h.zarr"
    options = {**SMALL, "task": str(slider_task), "out": url, "threads": 1}
    gen_histories(**options)
    found = Histories(url).read(0, 40)
    assert all(np.array_equal(found[s.path], expected[s.path]) for s in DATA)
    with pytest.raises(OutputError, match=r"holds histories[\s\S]*--force"):
        gen_histories(**options)
    assert gen_histories(**options, resume=True)["shards_made"] == 0
    gen_histories(**{**options, "pairs": 20}, force=True)
    assert len(Histories(url)) == 20
    assert len(Histories(generate(f"file://{tmp_path}/f.zarr"))) == 40


def test_a_url_of_no_known_scheme(generate):
    with pytest.raises(StoreError, match=r"cannot be opened[\s\S]*s3fs"):
        generate("nowhere://bucket/h.zarr")


# --- reading ---


def test_a_lost_shard_is_noticed(generate):
    path = Path(generate())
    (path / "measured" / "c" / "1" / "0" / "0" / "0").unlink()
    histories = Histories(path)
    histories.read(0, 16)
    with pytest.raises(StoreError, match="measured of pair 16 is missing"):
        histories.read(0, 40)


def test_damaged_metadata_of_an_array_is_noticed(generate):
    path = Path(generate())
    (path / "measured" / "zarr.json").write_text("garbage")
    with pytest.raises(StoreError, match="is not JSON"):
        Histories(path)


def test_inspect_reads_them_through(generate):
    path = Path(generate())
    sound = inspect(path)
    assert sound["sizes"] == {"arrays": 6, "pairs": 40, "rounds": 4}
    assert not sound["findings"]
    (path / "measured" / "c" / "1" / "0" / "0" / "0").unlink()
    assert [f["message"] for f in inspect(path)["findings"]] == [
        f"{path}: measured of pair 16 is missing or not finite"
    ]
    zarr.open_group(str(path), mode="r+").attrs["complete"] = False
    assert "--resume" in inspect(path)["findings"][0]["cure"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 99}, "capture/histories version 99"),
        ({"format": "other"}, "is not a capture/histories store"),
        ({"rounds": 5}, "its attributes say"),
    ],
)
def test_another_store_is_refused(generate, change, message):
    path = generate()
    zarr.open_group(path, mode="r+").attrs.update(change)
    with pytest.raises(StoreError, match=message):
        Histories(path)


def test_a_store_that_another_version_left_half_written_is_not_resumed(
    generate, stop_after, monkeypatch, tmp_path
):
    stop_after(1, Interrupted())
    with pytest.raises(Interrupted):
        generate()
    monkeypatch.undo()
    zarr.open_group(str(unfinished(tmp_path / "h.zarr")), mode="r+").attrs["version"] = 99
    with pytest.raises(StoreError, match="version 99"):
        generate(resume=True)


# --- options ---


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rounds": 1}, "--rounds 1"),
        ({"pairs": 0}, "--pairs 0"),
        ({"search": "bisection"}, "unknown search strategy"),
        ({"search": "binary", "alpha": 3.0}, "binary draws from no Beta"),
        ({"alpha": -1.0}, "--alpha -1"),
        ({"noise": "label"}, "observe a label"),
        ({"noise_sd": {"x": 1.0}}, "no feature 'x'"),
        ({"executor": "slurm"}, "--executor 'slurm'"),
        ({"address": "auto"}, "without --executor ray"),
        ({"policy": "sac"}, "--policy 'sac'"),
        ({"amplitude": None}, "how far to drive"),
        ({"amplitude": {"drive": 0.0}}, "--amplitude drive=0: .* is a number above 0"),
        ({"amplitude": {"drive": -3.0}}, "--amplitude drive=-3: .* is a number above 0"),
        ({"inputs_from": "log.zarr"}, "--amplitude means nothing"),
        ({"inputs_from": "log.zarr", "amplitude": None, "band": (0.1, 3.0)}, "--band means nothing"),
        ({"window": -1.0}, "--window -1"),
        ({"points": 1}, "--points 1"),
    ],
)
def test_bad_options(generate, options, message, tmp_path):
    with pytest.raises(OptionError, match=message):
        generate(**options)
    assert not list(tmp_path.glob("*h.zarr*"))


UNSEEN = """\
    <body name="other" pos="0 0 1">
      <joint type="slide" axis="1 0 0"/><geom name="other" type="sphere" size="0.1" mass="1"/>
    </body>
"""
MORE = """
[parameters.other]
set = "body:other:mass"
low = 0.5
high = 4.0
unit = "kg"
"""


def test_parameters_that_move_no_output_are_refused(generate, slider_task, tmp_path):
    model = slider_task.with_name("model.xml")
    model.write_text(model.read_text().replace("</worldbody>", f"{UNSEEN}</worldbody>"))
    slider_task.write_text(slider_task.read_text() + MORE)
    with pytest.raises(FitError, match="'slider': other moves no output"):
        generate()
    assert not list(tmp_path.glob("*h.zarr*"))


def test_a_machine_that_stands_still_is_refused(generate, slider_task):
    text = slider_task.read_text()
    slider_task.write_text(text.replace('[inputs.drive]\ncolumn = "u_N"\nunit = "N"\n', ""))
    with pytest.raises(FitError, match="mass, damping moves no output"):
        generate(amplitude=None)


def test_a_parameter_that_few_actions_show_is_learned(slider_task):
    """How hard a wall is, which one action in fifty reaches."""
    model = slider_task.with_name("model.xml")
    wall = '<geom name="wall" type="box" pos="1.2 0 0" size="0.1 1 1"/>'
    model.write_text(model.read_text().replace("<worldbody>", f"<worldbody>{wall}"))
    text = slider_task.read_text().replace("joint:x:damping", "geom:wall:solref_timeconst")
    slider_task.write_text(text.replace("low = 0.0\nhigh = 8.0", "low = 0.005\nhigh = 0.05"))
    task = sequence_task(load_task(str(slider_task)), Multisines(DRIVEN), points=5, window=0.1)
    task.library = np.repeat(task.library[:1], 1000, axis=0)
    with pytest.raises(FitError, match="damping moves no output"):
        check_parameters_move_trajectories(task, seed=0, threads=1)
    task.library[::50, :2] = 0.99, 1.0  # just before the wall, and on its way
    task.library[0] = task.library[1]
    check_parameters_move_trajectories(task, seed=0, threads=1)


def test_a_task_without_parameters_is_refused(generate, slider_task):
    text = slider_task.read_text()
    slider_task.write_text(text[: text.index("[parameters.mass]")] + text[text.index("[inputs.drive]") :])
    with pytest.raises(TaskError, match="no parameters") as caught:
        generate()
    assert "[parameters.NAME]" in caught.value.cure


# --- policies ---


class Still(Policy):
    """Always the same action, kept as weights."""

    def __init__(self, task, action):
        super().__init__(task)
        self.action = action

    def act(self, parameters, uniform):
        return np.repeat(self.action[None], len(parameters), axis=0)

    def state(self):
        return {"why": "a test"}, {"action": self.action}

    @classmethod
    def from_state(cls, task, settings, weights):
        assert settings == {"why": "a test"}
        return cls(task, weights["action"])


@pytest.fixture
def checkpoint(slider, tmp_path, monkeypatch):
    """A checkpoint of `Still`, as the kind "random", whose class it takes the place of."""
    monkeypatch.setattr(policy_checkpoint.REGISTRY, "get", lambda name: Still)
    (tmp_path / "policy").mkdir()
    save_policy(Still(slider, slider.library[3]), "still", tmp_path / "policy")
    return tmp_path / "policy"


def test_a_policy_from_its_checkpoint(checkpoint, generate, slider):
    actions = Histories(generate(policy=str(checkpoint))).read(0, 40)["actions"]
    assert np.all(actions == slider.library[3])


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"task": "air-hockey"}, OptionError, "is for the task 'air-hockey'"),
        ({"parameters": ["mass", "gain"]}, OptionError, r"its parameters are \(mass, gain\)"),
        ({"parameters": ["mass"]}, StoreError, "2 bounds of 1 parameters"),
        ({"version": 3}, StoreError, "version 3; this program reads"),
    ],
)
def test_a_policy_of_something_else(checkpoint, slider, change, error, message):
    settings = json.loads((checkpoint / "policy.json").read_text())
    (checkpoint / "policy.json").write_text(json.dumps({**settings, **change}))
    with pytest.raises(error, match=message):
        load_policy(str(checkpoint), slider)


def test_a_policy_without_its_weights(checkpoint, slider):
    (checkpoint / "policy.safetensors").write_bytes(b"not weights")
    with pytest.raises(StoreError, match=r"policy\.safetensors cannot be read"):
        load_policy(str(checkpoint), slider)


def test_what_lies_beside_a_policy_does_not_make_it_another(checkpoint, generate):
    """Nor does the hash of all files that earlier stores hold; other weights do."""
    again = {"policy": str(checkpoint), "resume": True}
    path = Path(generate(policy=str(checkpoint))) / "zarr.json"
    of_parts, of_all = checkpoint_hash(checkpoint), sha256(checkpoint)
    (checkpoint / ".DS_Store").write_bytes(b"of a file manager")
    generate(**again)
    (checkpoint / ".DS_Store").unlink()
    (checkpoint / "training.png").write_bytes(b"drawn by another version")
    generate(**again)
    (checkpoint / "training.png").unlink()
    path.write_text(path.read_text().replace(of_parts, of_all))
    generate(**again)
    with (checkpoint / "policy.json").open("a") as file:
        file.write(" ")
    with pytest.raises(OptionError, match=r"differs: policy\.sha256 was"):
        generate(**again)


# --- the command ---


def test_the_command_prints_one_document(slider_task, tmp_path, generate):
    line = f"gen-histories --task {slider_task} --out {tmp_path / 'c.zarr'} --pairs 8 --rounds 4 --points 5 "
    line += "--window 0.1 --amplitude drive=3 --threads 1 --json"
    done = CliRunner().invoke(app, line.split(), catch_exceptions=False)
    document = json.loads(done.stdout)
    assert (document["pairs"], document["rounds"], document["shards_made"]) == (8, 4, 1)
    made, whole = Histories(tmp_path / "c.zarr").read(0, 8), Histories(generate()).read(0, 8)
    assert np.array_equal(made["measured"], whole["measured"])
