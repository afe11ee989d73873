"""How a run ends by a signal, whenever it comes: one message that is true, and the signal's exit code."""

from __future__ import annotations

import asyncio
import errno
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from zarr.storage import LocalStore

from capture_cli.common.signals import heed_signals, uninterrupted
from capture_cli.stages import import_log as stage
from capture_cli.store.histories import HistoriesWriter

REPOSITORY = Path(__file__).resolve().parents[1]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
NUMBERS = pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])


@pytest.fixture(autouse=True)
def not_in_the_background():
    """A shell's background jobs ignore Ctrl-C."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def log_files(tmp_path, slider_task) -> list[str]:
    """Arguments of an import."""
    rows = "\n".join(f"{0.1 * i},{i},{i}" for i in range(10))
    (tmp_path / "run.csv").write_text(f"t_s,u_N,q_m\n{rows}\n")
    return ["import-log", "run.csv", "--task", str(slider_task), "--out", "log.zarr"]


# ---- blocks that are not interrupted ----


@NUMBERS
def test_a_signal_waits_until_a_block_has_ended(number, code):
    received, ended = heed_signals(), []
    with pytest.raises(KeyboardInterrupt), uninterrupted():
        os.kill(os.getpid(), number)
        ended.append("the block")
    assert ended == ["the block"] and received == [number]


def test_a_second_signal_does_not_end_the_clearing_up():
    received = heed_signals()
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGTERM)
    os.kill(os.getpid(), signal.SIGTERM)
    os.kill(os.getpid(), signal.SIGINT)
    assert received == [signal.SIGTERM]


def test_a_thread_may_have_such_blocks_too():
    done = []

    def work():
        with uninterrupted():
            done.append("work")

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == ["work"]


# ---- what is said ----


@NUMBERS
def test_an_import_that_is_interrupted_when_its_log_is_whole_says_so(
    capture, log_files, monkeypatch, tmp_path, number, code
):
    replace = Path.replace

    def interrupted(self, target):
        moved = replace(self, target)
        if ".partial-" in self.name:
            os.kill(os.getpid(), number)
        return moved

    monkeypatch.setattr(Path, "replace", interrupted)
    ended, _, err = capture(*log_files)
    out = tmp_path / "log.zarr"
    assert (ended, err) == (
        code,
        f"interrupted when all was written: {out}\n  cure: none is needed, it is whole\n",
    )
    assert out.is_dir() and not list(tmp_path.glob(".*"))
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    assert capture("inspect", "log.zarr")[0] == 0


def test_zarr_does_not_go_on_to_write_where_a_folder_was_cleared_away(
    capture, log_files, monkeypatch, tmp_path
):
    """It writes in threads of its own: an interrupted record left a folder that was not there when it was removed."""
    put = LocalStore.set

    async def slow(self, key, value):
        if not sent:
            sent.append(os.kill(os.getpid(), signal.SIGINT))
        await asyncio.sleep(0.05)
        await put(self, key, value)

    sent = []
    monkeypatch.setattr(LocalStore, "set", slow)
    before = sorted(tmp_path.iterdir())
    ended, _, err = capture(*log_files)
    assert (ended, err) == (130, "interrupted: nothing was written\n  cure: run the same command again\n")
    time.sleep(1)
    assert sent and sorted(tmp_path.iterdir()) == before


def test_an_interrupted_import_turned_into_another_error_is_still_interrupted(
    capture, log_files, monkeypatch, tmp_path
):
    """As by a module in C whose import is interrupted."""

    def interrupted(*_, **__):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
        except KeyboardInterrupt:
            raise ImportError("numpy failed to import") from None

    monkeypatch.setattr(stage, "load_task", interrupted)
    ended, _, err = capture(*log_files)
    assert (ended, err) == (143, "interrupted: nothing was written\n  cure: run the same command again\n")


@pytest.mark.parametrize("after", [0, 1])
def test_histories_on_a_full_disk_say_what_is_kept(capture, monkeypatch, tmp_path, after):
    """It was said that what was written is kept also where nothing was."""
    write, written = HistoriesWriter.write, []

    def full(self, *arguments):
        if len(written) == after:
            raise OSError(errno.ENOSPC, "No space left on device")
        written.append(write(self, *arguments))

    monkeypatch.setattr(HistoriesWriter, "write", full)
    options = ("--task", "scooping", "--policy", "random", "--pairs", 300, "--rounds", 2, "--out", "h.zarr")
    ended, _, err = capture("gen-histories", *options, "--quiet")
    assert ended == 2
    out = tmp_path / "h.zarr"
    if after:
        assert f"the disk is full: {out} is unfinished, and 256 of 300 histories are kept\n" in err
        assert err.endswith("  cure: free some space, and go on with --resume\n")
        assert (tmp_path / ".h.zarr.unfinished").is_dir()
    else:
        assert f"the disk is full: {out} was not written\n  cure: free some space" in err
        assert not list(tmp_path.iterdir())


OTHERWISE = """
import ctypes, os, signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs start with it ignored
from capture_cli.cli import app
from capture_cli.cli import main

def from_c(_):
    ctypes.pythonapi.PyRun_SimpleString(f"import os; os.kill(os.getpid(), {sys.argv[1]})".encode())
    raise KeyboardInterrupt

class Freed:
    def __del__(self):
        os.kill(os.getpid(), int(sys.argv[1]))

def swallowed(_):
    Freed()
    time.sleep(20)

def made_an_exit_code(_):
    try:
        os.kill(os.getpid(), int(sys.argv[1]))
    except KeyboardInterrupt:
        sys.exit(130)

app.run = locals()[sys.argv[2]]
main()
"""


@NUMBERS
@pytest.mark.parametrize("what", ["from_c", "made_an_exit_code", "swallowed"])
def test_what_a_library_makes_of_an_interrupt_changes_neither_code_nor_message(tmp_path, number, code, what):
    """`python -m` ended itself by SIGINT, whatever the signal was; and typer says nothing before a command runs."""
    (tmp_path / "otherwise.py").write_text(OTHERWISE)
    run = [sys.executable, "-m", "otherwise", str(int(number)), what]
    done = subprocess.run(run, cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == code
    assert done.stderr.endswith("interrupted: nothing was written\n  cure: run the same command again\n")
    assert "Traceback" not in done.stderr or what == "from_c", "which prints it itself"


LATE = """
import atexit, os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs start with it ignored
atexit.register(lambda: [os.kill(os.getpid(), n) for n in (signal.SIGINT, signal.SIGTERM)])
sys.argv = ["capture", *sys.argv[1:]]
from capture_cli.cli import main
main()
"""


@pytest.mark.parametrize(("arguments", "code"), [(["tasks"], 0), (["tasks", "--task", "nowhere"], 2)])
def test_a_signal_at_the_interpreters_end_changes_nothing(arguments, code):
    done = subprocess.run(
        [sys.executable, "-c", LATE, *arguments], env=ENVIRONMENT, capture_output=True, text=True
    )
    assert done.returncode == code
    assert "interrupted" not in done.stderr and "Traceback" not in done.stderr


EARLY = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)

class Finder:
    def find_spec(self, name, *_):
        if name == "typer":
            os.kill(os.getpid(), int(sys.argv[1]))

sys.meta_path.insert(0, Finder())
from capture_cli.cli import main
main()
"""


@NUMBERS
def test_a_signal_while_modules_are_imported_has_its_message(number, code):
    done = subprocess.run(
        [sys.executable, "-c", EARLY, str(int(number))], env=ENVIRONMENT, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (code, "")
    assert done.stderr == "interrupted: nothing was written\n  cure: run the same command again\n"
