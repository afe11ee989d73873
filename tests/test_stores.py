"""Stores and outputs: what is written reads back, damage is refused, nothing is half-written."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import zarr
from episodes_of import episodes_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from new_file import new_file
from toy_rounds import histories, write

from capture_cli.context.checkpoints.identifier_checkpoint import load_identifier
from capture_cli.context.checkpoints.policy_checkpoint import read_policy
from capture_cli.errors import CaptureError, Interrupted, LogError, OutputError, StoreError
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.stages.identification.chosen_identifier import SHIPPED
from capture_cli.stages.import_log import import_log
from capture_cli.store import output
from capture_cli.store.document_shape import BOUNDS, COUNT, NUMBER, POSITIVE, TEXT, check_shape, or_none
from capture_cli.store.evaluation import Evaluation
from capture_cli.store.histories import Histories
from capture_cli.store.output import (
    PROVENANCE,
    new_directory,
    refuse_existing,
    refuse_misnamed,
    resumable_directory,
    sha256,
)
from capture_cli.store.result import DocumentKind, read_result
from capture_cli.store.schema import ArraySpec, Schema
from capture_cli.store.tensors import save_arrays

REPOSITORY = Path(__file__).resolve().parents[1]


def a_log(steps: int = 20, inputs: int = 2) -> MeasuredLog:
    noise = np.random.default_rng(0)
    return MeasuredLog(
        task="slider",
        time=np.concatenate([np.arange(8.0), np.arange(steps - 8.0)]),
        inputs=noise.standard_normal((steps, inputs)),
        outputs=noise.standard_normal((steps, 1)),
        episode_ends=np.array([8, steps]),
        recording=np.array([0, 0]),
        input_names=tuple(f"u{i}" for i in range(inputs)),
        input_units=("N",) * inputs,
        output_names=("q",),
        output_units=("m",),
        recordings=({"name": "run", "source": "run.csv", "sha256": ""},),
    )


def assert_equal(one: MeasuredLog, other: MeasuredLog) -> None:
    for f in fields(MeasuredLog):
        if f.compare:
            np.testing.assert_array_equal(getattr(one, f.name), getattr(other, f.name), err_msg=f.name)


@pytest.fixture
def stored(tmp_path) -> Path:
    """A log on disk, with the provenance.json that every output has."""
    a_log().write(tmp_path / "log.zarr")
    (tmp_path / "log.zarr" / PROVENANCE).write_text("{}")
    return tmp_path / "log.zarr"


def refusal(path: Path) -> CaptureError:
    with pytest.raises((StoreError, LogError)) as caught:
        MeasuredLog.read(path)
    assert caught.value.cure
    return caught.value


def rewrite(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


# --- the measured log ---


@pytest.mark.parametrize(
    "log",
    [a_log(), a_log(inputs=0), replace(a_log(), actions=np.array([[1.0, 2.0], [3.0, 4.0]]))],
    ids=["plain", "no-inputs", "with-actions"],
)
def test_a_log_round_trips(tmp_path, log):
    log.write(tmp_path / "log.zarr")
    assert_equal(MeasuredLog.read(tmp_path / "log.zarr"), log)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=arrays(np.float64, st.tuples(st.integers(0, 40), st.integers(0, 3))))
def test_any_array_round_trips_bit_for_bit(tmp_path, values):
    schema = Schema("test/any", 1, (ArraySpec("a/b", "row column", "1", ""),), {}, "")
    schema.write(tmp_path / "any.zarr", {"a/b": values}, {})
    found = schema.read(tmp_path / "any.zarr")[0]["a/b"]
    assert found.tobytes() == values.tobytes()
    assert found.shape == values.shape


def test_arrays_larger_than_a_chunk_round_trip(tmp_path):
    schema = Schema("test/large", 1, (ArraySpec("a", "row column", "1", ""),), {}, "")
    values = np.arange(1.5e6).reshape(-1, 3)
    schema.write(tmp_path / "large.zarr", {"a": values}, {})
    assert len(list((tmp_path / "large.zarr" / "a" / "c").iterdir())) == 3
    np.testing.assert_array_equal(schema.read(tmp_path / "large.zarr")[0]["a"], values)


@pytest.mark.parametrize("umask", [0o022, 0o027])
def test_weights_may_be_read_by_whom_other_files_may(tmp_path, umask):
    before = os.umask(umask)
    try:
        save_arrays(tmp_path / "weights.safetensors", {"a": np.ones(3)}, {"of": "a test"})
        (tmp_path / "other.json").write_text("{}")
    finally:
        os.umask(before)
    weights, other = (
        (tmp_path / name).stat().st_mode & 0o777 for name in ("weights.safetensors", "other.json")
    )
    assert oct(weights) == oct(other)


def test_a_version_2_store_of_the_same_layout_is_read(tmp_path):
    log = a_log()
    group = zarr.open_group(str(tmp_path / "old.zarr"), mode="w", zarr_format=2)
    group.attrs.update(
        {
            "format": "capture/measured-log",
            "version": 1,
            "task": "slider",
            "inputs": [{"name": n, "unit": "N"} for n in log.input_names],
            "outputs": [{"name": "q", "unit": "m"}],
            "recordings": list(log.recordings),
        }
    )
    with zarr.config.set({"array.write_empty_chunks": True}):
        for name in ("data/time", "data/inputs", "data/outputs", "meta/episode_ends", "meta/recording"):
            group.create_array(name, data=getattr(log, name.split("/")[1]))
    assert (tmp_path / "old.zarr" / ".zattrs").is_file()
    assert_equal(MeasuredLog.read(tmp_path / "old.zarr"), log)


def test_reading_leaves_the_store_as_it_is(stored):
    before = sha256(stored)
    MeasuredLog.read(stored)
    assert sha256(stored) == before


# --- damaged and foreign stores ---


def test_another_version_is_refused_with_the_command_that_mends_it(stored):
    rewrite(stored / "zarr.json", '"version": 1', '"version": 2')
    error = refusal(stored)
    assert "capture/measured-log version 2; this program reads 1" in error.message
    assert "`capture import-log`" in error.cure


def test_foreign_stores_are_refused(tmp_path):
    zarr.open_group(str(tmp_path / "other.zarr"), mode="w").create_array("data/time", data=np.arange(3.0))
    assert (
        "is not a capture/measured-log store: it has no 'format' attribute"
        in refusal(tmp_path / "other.zarr").message
    )
    (tmp_path / "empty").mkdir()
    assert "is not a readable Zarr group" in refusal(tmp_path / "empty").message
    (tmp_path / "run.csv").write_text("t_s\n")
    assert "import-log" in refusal(tmp_path / "run.csv").cure
    assert "does not exist" in refusal(tmp_path / "nowhere.zarr").message


def test_a_missing_array_names_those_that_exist(stored):
    (stored / "data" / "outputs").rename(stored / "data" / "output")
    assert "the array 'data/outputs' is missing; did you mean 'data/output'" in refusal(stored).message


@pytest.mark.parametrize("name", ["data/time", "data/inputs", "meta/recording"])
def test_a_missing_chunk_is_noticed_even_where_all_is_zero(stored, name):
    chunk = next(f for f in (stored / name / "c").rglob("*") if f.is_file())
    chunk.unlink()
    assert f"{name} has 0 of its 1 chunks: it is truncated" in refusal(stored).message


def test_a_chunk_cut_short_is_refused(stored):
    chunk = stored / "data" / "outputs" / "c" / "0" / "0"
    chunk.write_bytes(chunk.read_bytes()[:-5])
    assert "data/outputs cannot be decoded" in refusal(stored).message


def test_no_flipped_bit_of_a_chunk_goes_unnoticed(stored):
    chunk = stored / "data" / "time" / "c" / "0"
    sound = chunk.read_bytes()
    time = MeasuredLog.read(stored).time
    refused = 0
    for at in range(len(sound)):
        damaged = bytearray(sound)
        damaged[at] ^= 1 << at % 8
        chunk.write_bytes(damaged)
        try:
            np.testing.assert_array_equal(MeasuredLog.read(stored).time, time)  # a bit that means nothing
        except StoreError:
            refused += 1
    assert refused >= len(sound) - 4


@pytest.mark.parametrize("content", ["", "{", "[]", "{}", '{"node_type": "array", "zarr_format": 3}'])
@pytest.mark.parametrize("name", ["zarr.json", "data/time/zarr.json"])
def test_damaged_metadata_are_refused(stored, name, content):
    (stored / name).write_text(content)
    assert isinstance(refusal(stored), StoreError)


def test_axes_that_disagree_are_refused(tmp_path):
    replace(a_log(), outputs=np.zeros((5, 1))).write(tmp_path / "log.zarr")
    assert (
        "axis 'step' has 20 entries in data/time and 5 in data/outputs"
        in refusal(tmp_path / "log.zarr").message
    )


def test_an_array_with_other_axes_is_refused(stored):
    group = zarr.open_group(str(stored), mode="a")
    group.create_array("data/inputs", data=np.zeros(20), overwrite=True)
    assert "data/inputs has shape (20,); expected axes (step, input)" in refusal(stored).message


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"task"', '"tusk"', "attributes missing: task"),
        ('"name": "u1"', '"nome": "u1"', "inputs[1].name missing"),
        ('"outputs": [', '"outputs": [{"name": "p", "unit": "m"},', "expected 1 of {name, unit}"),
        ('"recordings": [', '"recordings": [], "more": [', "points outside the attribute 'recordings'"),
        ('"name": "run"', '"nome": "run"', "recordings[0].name missing"),
    ],
)
def test_attributes_that_do_not_fit_the_arrays_are_refused(stored, old, new, words):
    rewrite(stored / "zarr.json", old, new)
    assert words in refusal(stored).message


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(time=np.zeros(20)), "time does not increase in episode 0: 0 s at step 0, then 0 s"),
        (dict(inputs=np.full((20, 2), -1e16)), "input 'u0' is -1e+16 at step 0 (20 such values), too large"),
        (dict(inputs=np.full((20, 2), np.nan)), "input 'u0' is nan at step 0 (20 such values)"),
        (dict(outputs=np.full((20, 1), np.inf)), "output 'q' is inf"),
        (dict(episode_ends=np.array([8, 19])), "do not divide 20 steps"),
        (dict(episode_ends=np.array([20, 8])), "do not divide 20 steps"),
    ],
)
def test_values_that_cannot_be_used_are_refused_but_can_be_looked_at(tmp_path, change, words):
    replace(a_log(), **change).write(tmp_path / "log.zarr")
    assert words in refusal(tmp_path / "log.zarr").message
    assert len(MeasuredLog.read_unchecked(tmp_path / "log.zarr").time) == 20


def test_only_a_sparse_output_may_lack_samples(tmp_path):
    values = np.where(np.arange(20)[:, None] % 2, np.nan, 1.0)
    lacking = replace(a_log(), outputs=values)
    lacking.write(tmp_path / "log.zarr")
    assert "output 'q' is nan at step 1 (10 such values)" in refusal(tmp_path / "log.zarr").message
    one = {"time": np.arange(20.0), "episode_ends": np.array([20]), "recording": np.array([0])}
    sparse = replace(lacking, **one, sparse=frozenset({"q"}))
    sparse.write(tmp_path / "sparse.zarr")
    found = MeasuredLog.read(tmp_path / "sparse.zarr")
    assert_equal(sparse, found)
    assert found.sampled.sum() == 10 and found.values.sum() == 10
    replace(sparse, outputs=np.where(np.arange(20)[:, None] == 3, np.inf, values)).write(
        tmp_path / "inf.zarr"
    )
    assert "output 'q' is inf at step 3 (1 such values)" in refusal(tmp_path / "inf.zarr").message
    replace(sparse, outputs=np.where(np.arange(20)[:, None] > 7, np.nan, values)).write(tmp_path / "few.zarr")
    assert "has 4 samples in the 20 steps of episode 0" in refusal(tmp_path / "few.zarr").message
    assert len(MeasuredLog.read_unchecked(tmp_path / "few.zarr").time) == 20


def test_an_empty_log_is_refused(tmp_path):
    episodes_of(a_log(), []).write(tmp_path / "log.zarr")
    assert "the log is empty" in refusal(tmp_path / "log.zarr").message


# --- outputs appear whole or not at all ---


def names(folder: Path) -> list[str]:
    return sorted(f.name for f in folder.iterdir())


keeping_all = partial(resumable_directory, kept=lambda folder: "all of it is kept")
keeping_nothing = partial(resumable_directory, kept=lambda folder: "")


def fill(folder: Path, content: str = "new") -> None:
    (folder / "data").write_text(content)
    (folder / PROVENANCE).write_text("{}")


def test_an_output_appears_when_it_is_complete(tmp_path):
    with new_directory(tmp_path / "deep" / "out") as folder:
        fill(folder)
        assert not (tmp_path / "deep" / "out").exists()
    assert names(tmp_path / "deep") == ["out"]
    with new_file(tmp_path / "model.xml") as file:
        file.write_text("new")
        assert not (tmp_path / "model.xml").exists()
    assert names(tmp_path) == ["deep", "model.xml"]


@pytest.mark.parametrize("new", [new_directory, new_file])
def test_an_output_that_exists_is_refused_and_left_alone(tmp_path, new):
    (tmp_path / "out").mkdir()
    fill(tmp_path / "out", "old")
    with pytest.raises(OutputError, match="exists already") as caught, new(tmp_path / "out"):
        pytest.fail("the block must not be entered")
    assert "--force" in caught.value.cure
    assert (tmp_path / "out" / "data").read_text() == "old"


def test_force_replaces_a_result_and_an_empty_folder(tmp_path):
    (tmp_path / "out").mkdir()
    for content in ("first", "second"):
        with new_directory(tmp_path / "out", force=True) as folder:
            fill(folder, content)
        assert (tmp_path / "out" / "data").read_text() == content
        assert names(tmp_path) == ["out"]


def test_force_replaces_no_device(tmp_path):
    """As root `--out /dev/null --force` had made a folder of it."""
    os.mkfifo(tmp_path / "pipe")
    for new in (new_directory, new_file, keeping_all):
        with pytest.raises(OutputError, match="is a device or a pipe"), new(tmp_path / "pipe", force=True):
            pytest.fail("the block must not be entered")
    assert (tmp_path / "pipe").is_fifo()


def test_force_replaces_a_file_by_a_file_only(tmp_path):
    (tmp_path / "out").write_text("old")
    with pytest.raises(OutputError, match="is a file"), new_directory(tmp_path / "out", force=True):
        pytest.fail("the block must not be entered")
    with new_file(tmp_path / "out", force=True) as file:
        file.write_text("new")
    assert (tmp_path / "out").read_text() == "new"


def test_force_does_not_replace_what_capture_did_not_write(tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter1.tex").write_text("years of work")
    with (
        pytest.raises(OutputError, match=r"no provenance\.json"),
        new_directory(tmp_path / "thesis", force=True),
    ):
        pytest.fail("the block must not be entered")
    assert (tmp_path / "thesis" / "chapter1.tex").read_text() == "years of work"


@pytest.mark.parametrize("new", [new_directory, new_file])
@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_failure_leaves_nothing_and_what_was_there(tmp_path, new, error):
    with pytest.raises(error), new(tmp_path / "out") as partial:
        fill(partial) if partial.is_dir() else partial.write_text("half")
        raise error
    assert names(tmp_path) == []


HOLDING = """
import sys, time
from pathlib import Path
from capture_cli.store.output import resumable_directory

with resumable_directory(Path(sys.argv[1]), kept=str):
    print("writing", flush=True)
    time.sleep(100)
"""


def test_a_run_that_is_still_at_work_is_neither_resumed_nor_replaced(tmp_path):
    out = tmp_path / "out"
    run = subprocess.Popen([sys.executable, "-c", HOLDING, str(out)], stdout=subprocess.PIPE, text=True)
    assert run.stdout.readline() == "writing\n"
    for options in ({}, {"resume": True}, {"force": True}):
        with (
            pytest.raises(
                OutputError, match=rf"process {run.pid} on .*, since .*, is writing .*out"
            ) as caught,
            keeping_all(out, **options),
        ):
            pytest.fail("the block must not be entered")
        assert caught.value.cure == "wait until it ends, or stop it"
    run.kill()
    run.wait()
    with keeping_all(out, resume=True) as folder:
        fill(folder)
    assert names(tmp_path) == ["out"]


@pytest.mark.parametrize(
    ("error", "raised", "said"),
    [
        (KeyboardInterrupt(), Interrupted, r"interrupted: all of it is kept[\s\S]*--resume"),
        (
            OSError(errno.ENOSPC, ""),
            OutputError,
            r"disk is full: .*out is unfinished, and all of it is kept[\s\S]*",
        ),
        (ValueError("a fault"), ValueError, "a fault"),
    ],
)
def test_what_long_work_leaves_is_said_and_gone_on_with(tmp_path, error, raised, said):
    with pytest.raises(raised, match=said), keeping_all(tmp_path / "out") as folder:
        fill(folder)
        raise error
    with (
        pytest.raises(
            OutputError, match=r"left .*out unfinished \(in \.out\.unfinished\): all of it is kept"
        ),
        keeping_all(tmp_path / "out"),
    ):
        pytest.fail("the block must not be entered")
    with keeping_all(tmp_path / "out", resume=True) as folder:
        assert (folder / "data").read_text() == "new"


@pytest.mark.parametrize(
    ("error", "raised", "said"),
    [
        (KeyboardInterrupt(), KeyboardInterrupt, "^$"),
        (OSError(errno.ENOSPC, ""), OutputError, "the disk is full: .*out was not written"),
    ],
)
def test_long_work_that_keeps_nothing_leaves_nothing(tmp_path, error, raised, said):
    with pytest.raises(raised, match=said), keeping_nothing(tmp_path / "out") as folder:
        fill(folder)
        raise error
    assert names(tmp_path) == []
    (tmp_path / ".out.unfinished").mkdir()  # of a run that was killed before it had anything
    fill(tmp_path / ".out.unfinished", "half")
    with keeping_nothing(tmp_path / "out") as folder:
        assert names(folder) == []
    assert names(tmp_path) == ["out"]


def test_what_is_not_of_the_output_stays_until_it_is_in_its_place(tmp_path, monkeypatch):
    """A run that was killed while it synced had lost the state that it could have gone on from."""
    monkeypatch.setattr(output, "_sync", lambda _: (tmp_path / ".out.unfinished" / "state").stat())
    with keeping_all(tmp_path / "out", scaffold=("state", "gone")) as folder:
        fill(folder)
        (folder / "state").write_text("counters")
    assert names(tmp_path / "out") == ["data", PROVENANCE]


def test_a_failure_with_force_leaves_the_old_result(tmp_path):
    (tmp_path / "out").mkdir()
    fill(tmp_path / "out", "old")
    with pytest.raises(ValueError), new_directory(tmp_path / "out", force=True) as folder:
        fill(folder)
        raise ValueError
    assert (tmp_path / "out" / "data").read_text() == "old"
    assert names(tmp_path) == ["out"]


def test_a_result_that_appeared_meanwhile_is_not_replaced(tmp_path):
    with pytest.raises(OutputError, match="exists already"), new_directory(tmp_path / "out") as folder:
        fill(folder, "slow")
        (tmp_path / "out").mkdir()
        fill(tmp_path / "out", "quick")
    assert (tmp_path / "out" / "data").read_text() == "quick"
    assert names(tmp_path) == ["out"]


def test_a_rename_that_fails_puts_the_old_result_back(tmp_path, monkeypatch):
    (tmp_path / "out").mkdir()
    fill(tmp_path / "out", "old")

    def fails(self, target):
        raise OSError(errno.EIO, "input/output error")

    monkeypatch.setattr(output, "_exchange", lambda *_: False)  # as where the system cannot
    monkeypatch.setattr(Path, "replace", fails)
    with (
        pytest.raises(OutputError, match="input/output error"),
        new_directory(tmp_path / "out", force=True) as folder,
    ):
        fill(folder)
    assert (tmp_path / "out" / "data").read_text() == "old"
    assert names(tmp_path) == ["out"]


@pytest.mark.parametrize("where", ["write", "sync"])
def test_a_full_disk_is_an_output_error_and_leaves_nothing(tmp_path, monkeypatch, where):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    if where == "write":
        monkeypatch.setattr("zarr.storage.LocalStore.set", full)
    else:
        monkeypatch.setattr(os, "fsync", full)
    with (
        pytest.raises(OutputError, match="the disk is full") as caught,
        new_directory(tmp_path / "out") as folder,
    ):
        a_log().write(folder)
    assert "free some space" in caught.value.cure
    assert names(tmp_path) == []


def test_a_folder_that_cannot_be_made_is_an_output_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"), new_directory(tmp_path / "file" / "out"):
        pytest.fail("the block must not be entered")


def dead_process() -> int:
    """The id of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_leftovers_of_dead_runs_are_removed_and_those_of_live_ones_kept(tmp_path):
    dead, live = dead_process(), os.getppid()
    for pid in (dead, live):
        for mark in ("partial", "replaced"):
            (tmp_path / f".out.{mark}-{pid}").mkdir()
            fill(tmp_path / f".out.{mark}-{pid}")
    (tmp_path / f".other.partial-{dead}").mkdir()
    (tmp_path / f".model.xml.partial-{dead}").write_text("half")
    with new_directory(tmp_path / "out") as folder:
        fill(folder)
    with new_file(tmp_path / "model.xml") as file:
        file.write_text("new")
    kept = [f".other.partial-{dead}", f".out.partial-{live}", f".out.replaced-{live}", "model.xml", "out"]
    assert names(tmp_path) == kept


def test_the_only_copy_of_what_a_dead_run_moved_away_is_kept(tmp_path):
    moved = tmp_path / f".out.replaced-{dead_process()}"
    moved.mkdir()
    fill(moved, "old")
    with pytest.raises(ZeroDivisionError), new_directory(tmp_path / "out"):
        1 / 0  # noqa: B018
    assert names(tmp_path) == [moved.name]
    with new_directory(tmp_path / "out") as folder:
        fill(folder)
    assert names(tmp_path) == ["out"]


def test_refuse_existing_lets_a_new_path_pass(tmp_path):
    refuse_existing(tmp_path / "new", force=False)


# where a run is killed: the function at whose call the process kills itself
KILLED_AT = {
    "while arrays are written": "zarr.Group.create_array",
    "before provenance": "capture_cli.store.provenance.Provenance.write",
    "while it is synced": "os.fsync",
    "before it is moved": "capture_cli.store.output._move_into_place",
    "when it is in its place": "capture_cli.store.output._sync_parent",
}
KILLED_RUN = """
import os, pkgutil, signal, sys
from pathlib import Path
from capture_cli.stages import import_log

owner, _, name = sys.argv[4].rpartition(".")
owner = pkgutil.resolve_name(owner)
original = getattr(owner, name)
calls = []

def dies(*arguments, **options):
    calls.append(arguments)
    if len(calls) == (2 if name == "create_array" else 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return original(*arguments, **options)

import zarr
setattr(owner, name, dies)
import_log.import_log(files=[Path(sys.argv[1])], task=sys.argv[2], out=Path(sys.argv[3]), force=True)
"""


@pytest.mark.parametrize("killed_at", KILLED_AT.values(), ids=KILLED_AT)
def test_a_killed_import_leaves_nothing_and_then_succeeds(tmp_path, slider_task, killed_at):
    rows = "\n".join(f"{0.1 * i},{i},{i}" for i in range(10))
    (tmp_path / "run.csv").write_text(f"t_s,u_N,q_m\n{rows}\n")
    out = tmp_path / "results" / "run.zarr"
    out.mkdir(parents=True)
    fill(out, "old")
    run = [sys.executable, "-c", KILLED_RUN, str(tmp_path / "run.csv"), str(slider_task), str(out), killed_at]
    killed = subprocess.run(
        run, env={**os.environ, "PYTHONPATH": str(REPOSITORY)}, capture_output=True, text=True
    )
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    moved = killed_at.endswith("_sync_parent")
    assert [f for f in names(out.parent) if not f.startswith(".")] == ["run.zarr"], (
        "there is no moment without"
    )
    assert [f for f in names(out.parent) if f.startswith(".run.zarr.")]
    assert (out / "zarr.json").exists() is moved
    import_log(files=[tmp_path / "run.csv"], task=str(slider_task), out=out, force=True)
    assert names(out.parent) == ["run.zarr"]
    assert len(MeasuredLog.read(out).time) == 10


def test_a_result_that_is_not_there_is_said_to_be_missing(tmp_path):
    with pytest.raises(StoreError, match="nowhere does not exist"):
        read_result(tmp_path / "nowhere", "estimate.json", DocumentKind("capture/estimate", 1, "make it"))


# --- names of outputs ---


@pytest.mark.parametrize("path", ["gone/../new", "gone/deep/../new", "there/../gone/../new"])
def test_a_path_up_from_a_folder_that_there_is_not_is_refused(tmp_path, monkeypatch, path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there").mkdir()
    for new in (new_directory, new_file):
        with pytest.raises(OutputError, match=r"goes up from .*gone.*, which does not exist"):
            new(Path(path)).__enter__()
    assert [f.name for f in tmp_path.iterdir()] == ["there"]


def test_a_path_up_from_a_folder_is_taken(tmp_path, monkeypatch):
    (tmp_path / "there").mkdir()
    (tmp_path / "link").symlink_to("there")
    monkeypatch.chdir(tmp_path / "there")
    for path in ("../a", "../there/../b", "../link/../c", "d/e"):
        with new_file(Path(path)) as file:
            file.write_text("1")
        assert Path(path).read_text() == "1"


def test_a_file_is_named_as_what_it_is():
    for name in ("a.json", "a.JSON", "a", "a.txt", "a.json/b", "a.7"):
        refuse_misnamed(Path(name), ".json")
    for name, called in (("a.xml", "XML"), ("b/a.CSV", "CSV"), ("a.json.zarr", "Zarr")):
        with pytest.raises(OutputError, match=f"--truth .* named as {called}, .* JSON") as caught:
            refuse_misnamed(Path(name), ".json", option="--truth")
        assert caught.value.cure == "end its name in .json"


# --- documents ---

SHAPE = {
    "task": TEXT,
    "rounds": COUNT,
    "bounds": [BOUNDS],
    "noise": {str: NUMBER},
    "alpha": or_none(NUMBER),
    "peaks?": {str: POSITIVE},
}
RIGHT = {"task": "a", "rounds": 7, "bounds": [[0, 1]], "noise": {"q": 0.1}, "alpha": None}


def test_a_document_of_its_shape_is_taken():
    check_shape(RIGHT, SHAPE, "a.json", "cure")
    check_shape({**RIGHT, "alpha": 1.5, "peaks": {"u": 2}, "more": None}, SHAPE, "a.json", "cure")


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ([], r"is \[\]; expected an object"),
        ({"task": "a"}, "rounds, bounds, noise, alpha missing"),
        ({**RIGHT, "task": None}, "task is None; expected a text"),
        ({**RIGHT, "rounds": True}, "rounds is True; expected a whole number above 0"),
        ({**RIGHT, "rounds": 0}, "rounds is 0; expected a whole number above 0"),
        ({**RIGHT, "bounds": [[0, 1], [1, 1]]}, r"bounds\[1\] is \[1, 1\]; expected \[low, high\]"),
        ({**RIGHT, "noise": {"q": "x"}}, "noise.q is 'x'; expected a number"),
        ({**RIGHT, "noise": []}, r"noise is \[\]; expected an object"),
        ({**RIGHT, "alpha": "x" * 99}, r"alpha is 'x{36}\.\.\.; expected a number"),
        ({**RIGHT, "peaks": {"u": 0}}, "peaks.u is 0; expected a number above 0"),
        ({**RIGHT, "peaks": {"u": float("nan")}}, "peaks.u is nan"),
    ],
)
def test_what_a_document_lacks_or_mistypes_is_named(wrong, said):
    with pytest.raises(StoreError, match=rf"^a\.json cannot be read: .*{said}") as caught:
        check_shape(wrong, SHAPE, "a.json", "make it again")
    assert caught.value.cure == "make it again"


@pytest.mark.parametrize(
    ("name", "path", "value", "said"),
    [
        ("air-hockey", ("result",), {}, "result.pairs, .* missing"),
        (
            "air-hockey",
            ("result", "coverage", "left_damping"),
            {},
            r"coverage.left_damping is \{\}; expected a number",
        ),
        ("scooping", ("result", "coverage"), {"mass": 0.9}, r"coverage is of \(mass\); expected \(com\)"),
        ("scooping", ("result", "best_step"), "last", "best_step is 'last'; expected a whole number"),
        ("scooping", ("training", "steps"), [], "training.steps is"),
        ("scooping", ("architecture", "layers"), 2.0, "architecture.layers is 2.0"),
        ("scooping", ("signature", "parameters", 0, "step"), {}, r"parameters\[0\].step is"),
        ("air-hockey", ("histories", "search"), None, "histories.search is None; expected a text"),
        ("scooping", ("signature", "features", 0, "scale"), 0, "scale is 0; expected a number above 0"),
    ],
)
def test_a_checkpoint_with_a_mistyped_part_is_refused(tmp_path, name, path, value, said):
    folder = shutil.copytree(SHIPPED / name, tmp_path / name)
    _put(folder / "identifier.json", path, value)
    with pytest.raises(StoreError, match=said) as caught:
        load_identifier(folder)
    assert "identifier.json" in caught.value.message and "train-sysid" in caught.value.cure


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("result", "success"), [], r"result.success is \[\]; expected a number"),
        (("result", "random"), {}, "result.random.reward, result.random.success missing"),
        (("training", "steps"), "many", "training.steps is 'many'"),
        (("bounds", "actions", 0), [1, -1], r"bounds.actions\[0\] is \[1, -1\]"),
    ],
)
def test_a_policy_with_a_mistyped_part_is_refused(tmp_path, path, value, said):
    folder = shutil.copytree(REPOSITORY / "runs" / "policies" / "scooping", tmp_path / "policy")
    _put(folder / "policy.json", path, value)
    with pytest.raises(StoreError, match=said) as caught:
        read_policy(folder)
    assert "policy.json" in caught.value.message and "train-policy" in caught.value.cure


def test_a_policy_that_was_not_trained_says_nothing_of_training(tmp_path):
    folder = shutil.copytree(REPOSITORY / "runs" / "policies" / "scooping", tmp_path / "policy")
    document = json.loads((folder / "policy.json").read_text())
    (folder / "policy.json").write_text(json.dumps({k: v for k, v in document.items() if k != "result"}))
    read_policy(folder)
    with pytest.raises(StoreError, match="result missing"):
        read_policy(folder, trained=True)


def test_an_evaluation_without_a_round_is_refused(tmp_path):
    folder = shutil.copytree(REPOSITORY / "runs" / "evaluation" / "scooping", tmp_path / "evaluation")
    _put(
        folder / "evaluation.json",
        ("identifiers", "domain-randomization", "parameter_difference", "mean"),
        [],
    )
    with pytest.raises(StoreError, match=r"mean is \[\]; expected a list of numbers, one or more"):
        Evaluation.read(folder)


def test_histories_with_a_mistyped_attribute_are_refused(tmp_path):
    store = write(histories(4), tmp_path / "h.zarr")
    _put(store / "zarr.json", ("attributes", "shard_pairs"), 0)
    with pytest.raises(StoreError, match="shard_pairs is 0; expected a whole number above 0"):
        Histories(store)


def _put(file: Path, path: tuple, value) -> None:
    """Put `value` at `path` of a JSON file."""
    document = inner = json.loads(file.read_text())
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    file.write_text(json.dumps(document))
