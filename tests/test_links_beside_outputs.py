"""What lies beside an output before a run, links above all, is neither followed nor written to."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pytest
from new_file import new_file

from capture_cli.errors import OutputError
from capture_cli.model.tasks import load_task
from capture_cli.store.output import PROVENANCE, new_directory, resumable_directory
from capture_cli.store.writer_lock import only_writer

PRECIOUS = "years of work"
resumable = partial(resumable_directory, kept=lambda folder: "all of it is kept")


@pytest.fixture
def victim(tmp_path) -> Path:
    """A file of somebody's, out of the way; it is what it was when the test has ended."""
    path = tmp_path / "home" / "thesis.tex"
    path.parent.mkdir()
    path.write_text(PRECIOUS)
    yield path
    assert path.read_text() == PRECIOUS
    assert [f.name for f in path.parent.iterdir()] == [path.name]


@pytest.fixture
def here(tmp_path) -> Path:
    """Where an archive was unpacked, and outputs go."""
    path = tmp_path / "unpacked"
    path.mkdir()
    return path


def fill(folder: Path) -> None:
    (folder / "data").write_text("new")
    (folder / PROVENANCE).write_text("{}")


# ---- the lock ----


def test_a_link_in_the_place_of_a_lock_is_refused_and_its_target_left_alone(here, victim):
    (here / ".out.lock").symlink_to(victim)
    with (
        pytest.raises(
            OutputError, match=r"\.out\.lock is in the way: it is not the lock of a run but a link"
        ),
        only_writer(here / "out"),
    ):
        pytest.fail("the block must not be entered")
    assert (here / ".out.lock").is_symlink()


def test_a_lock_that_leads_to_nothing_makes_nothing(here, victim):
    (here / ".out.lock").symlink_to(victim.with_name("new.tex"))
    with pytest.raises(OutputError, match="in the way"), resumable(here / "out"):
        pytest.fail("the block must not be entered")


def test_another_file_in_the_place_of_a_lock_is_refused(here, victim):
    os.link(victim, here / ".out.lock")
    with pytest.raises(OutputError, match="in the way"), only_writer(here / "out"):
        pytest.fail("the block must not be entered")
    assert (here / ".out.lock").read_text() == PRECIOUS


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo])
def test_a_folder_or_a_pipe_in_the_place_of_a_lock_is_refused(here, make):
    make(here / ".out.lock")
    with pytest.raises(OutputError, match="in the way"), only_writer(here / "out"):
        pytest.fail("the block must not be entered")


@pytest.mark.parametrize("content", ["", "process 17 on there, since 2026-01-01T00:00:00+00:00,"])
def test_the_lock_of_a_dead_run_is_replaced_and_not_written_to(here, content):
    """It may be one more name of a file."""
    left, other = here / ".out.lock", here / "other"
    left.write_text(content)
    os.link(left, other)
    with only_writer(here / "out"):
        assert left.read_text().startswith(f"process {os.getpid()} on")
    assert other.read_text() == content and not left.exists()


# ---- what is written beside ----


@pytest.mark.parametrize("new", [new_directory, new_file])
@pytest.mark.parametrize("leads", ["to a file", "to a folder", "to nothing"])
def test_a_link_by_the_name_of_what_is_written_beside_is_not_followed(here, victim, new, leads):
    """An archive may hold one for every process id there is."""
    target = {"to a file": victim, "to a folder": victim.parent, "to nothing": victim.with_name("new")}[leads]
    (here / f".out.partial-{os.getpid()}").symlink_to(target)
    with new(here / "out") as partial:
        fill(partial) if partial.is_dir() else partial.write_text("new")
    assert [f.name for f in here.iterdir()] == ["out"] and not (here / "out").is_symlink()


@pytest.mark.parametrize("new", [new_directory, new_file, resumable])
@pytest.mark.parametrize("force", [False, True])
def test_an_output_that_is_a_link_is_refused(here, victim, new, force):
    for target in (victim, victim.parent, victim.with_name("new")):
        (here / "out").symlink_to(target)
        with (
            pytest.raises(OutputError, match="out is a symbolic link: outputs are not written through one"),
            new(here / "out", force=force),
        ):
            pytest.fail("the block must not be entered")
        (here / "out").unlink()


@pytest.mark.parametrize("options", [{}, {"resume": True}, {"force": True}])
def test_unfinished_work_that_is_a_link_is_refused(here, victim, options):
    (here / ".out.unfinished").symlink_to(victim.parent)
    with pytest.raises(OutputError, match=r"\.out\.unfinished is a link"), resumable(here / "out", **options):
        pytest.fail("the block must not be entered")


@pytest.mark.parametrize("name", ["state.safetensors.new", "steps", "deep/er"])
def test_unfinished_work_that_holds_a_link_is_not_gone_on_with(here, victim, name):
    link = here / ".out.unfinished" / name
    link.parent.mkdir(parents=True)
    link.symlink_to(victim.parent if name == "steps" else victim)
    with pytest.raises(OutputError, match=f"{name} is a link"), resumable(here / "out", resume=True):
        pytest.fail("the block must not be entered")
    with resumable(here / "out", force=True) as folder:
        fill(folder)
    assert [f.name for f in here.iterdir()] == ["out"]


# ---- MuJoCo's log ----


def test_mujoco_writes_no_log_where_a_run_was_started(here, victim, monkeypatch, slider_task):
    """It appends to MUJOCO_LOG.TXT in the working directory, and follows links."""
    (here / "MUJOCO_LOG.TXT").symlink_to(victim)
    monkeypatch.chdir(here)
    for task in ("air-hockey", str(slider_task)):
        config = mujoco.MjLogConfig.get()
        config.logto_file = True
        mujoco.MjLogConfig.set(config)
        model = load_task(task).model
        data = mujoco.MjData(model)
        data.qvel[:] = np.nan
        mujoco.mj_step(model, data)
