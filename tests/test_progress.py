"""Progress: the first line comes soon, whatever takes long, and says what is being done and how far that is."""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path

import pytest
from diagnosing import look_among
from setting_numbers import set_numbers

from capture_cli.common import progress as module
from capture_cli.common.progress import Progress
from capture_cli.errors import Interrupted
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.select.explain import Settings
from capture_cli.stages import diagnose as diagnose_stage
from capture_cli.stages import identify as identify_stage
from capture_cli.stages.log_to_fit import LogToFit
from capture_cli.stages.record import record

SLIDER = Path(__file__).parents[1] / "benchmarks" / "machines" / "slider" / "task.toml"


@pytest.fixture
def clock(monkeypatch):
    """The time that progress reads, s: a list of one number."""
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now


@pytest.fixture
def soon(monkeypatch):
    """The first line after 20 ms, and another every 50 ms."""
    set_numbers(monkeypatch, module, first=0.02)
    set_numbers(monkeypatch, module, plain_every=0.05)


def test_time_left_follows_from_what_came_before(clock):
    progress = Progress("diagnose", "model", quiet=True)
    clock[0] = 100.0
    progress.part("score", 0, 10)
    assert progress.said() == "score 1 of 10"
    clock[0] = 104.0
    progress.part("score", 2, 10)
    assert progress.said() == "score 3 of 10, 16 s left of these"
    clock[0] = 108.0  # the third takes longer than those before it, and so may the others
    assert progress.said() == "score 3 of 10, 28 s left of these"
    progress.part("score", 9, 10)
    clock[0] = 130.0
    assert progress.said() == "score 10 of 10, for 22 s"
    progress.part("refit", 0, 5, "; found drag@j")
    assert progress.said() == "refit 1 of 5; found drag@j"
    assert progress.count == 4


def test_what_stands_still_says_for_how_long(clock):
    progress = Progress("identify", "round", quiet=True)
    progress.of("step 1 of 5", "making the log ready")
    assert progress.said() == "step 1 of 5, making the log ready"
    clock[0] = 31.0
    assert progress.said() == "step 1 of 5, making the log ready, for 31 s"
    progress.step("cutting")
    assert progress.said() == "step 1 of 5, cutting"


def test_a_call_that_takes_long_is_told_of_while_it_does(soon, capsys):
    with Progress("identify", "round", quiet=False) as progress:
        progress.doing("one long call")
        time.sleep(0.3)
    lines = capsys.readouterr().err.splitlines()
    assert 2 <= len(lines) <= 7
    assert lines[0] == "identify: 0 s, one long call"
    assert not progress.teller.is_alive()


def test_what_is_done_soon_needs_no_line(capsys):
    with Progress("identify", "round", quiet=False) as progress:
        progress.doing("one short call")
    assert capsys.readouterr().err == ""


def test_quiet_has_nobody_who_tells(soon, capsys):
    with Progress("identify", "round", quiet=True) as progress:
        progress.doing("one long call")
        time.sleep(0.1)
        assert not progress.teller.is_alive()
    assert capsys.readouterr().err == ""


def test_where_nobody_listens_any_more_the_work_goes_on(soon, monkeypatch):
    def refuse(*_) -> None:
        raise BrokenPipeError

    monkeypatch.setattr(sys.stderr, "write", refuse)
    with Progress("identify", "round", quiet=False) as progress:
        progress.doing("one long call")
        time.sleep(0.1)
        assert progress.teller.is_alive()


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("log") / "run.zarr"
    record(task=str(SLIDER), out=path, noise=5e-4, episodes=2, duration=1.5, rate=250.0, threads=1)
    return path


@pytest.mark.parametrize("stage", ["identify", "diagnose"])
def test_the_first_line_comes_before_the_log_is_ready(
    log, tmp_path, soon, monkeypatch, without_pages, capsys, stage
):
    """However long it takes to read it and to make it ready."""
    prepared = LogToFit.prepared

    def slowly(*args):
        time.sleep(0.2)
        return prepared(*args)

    def read(*args):
        time.sleep(0.2)
        return whole

    whole = MeasuredLog.read(log)
    monkeypatch.setattr(MeasuredLog, "read", read)
    monkeypatch.setattr(LogToFit, "prepared", slowly)
    look_among(monkeypatch, "coulomb-friction")
    run = {"identify": identify_stage.identify, "diagnose": diagnose_stage.diagnose}[stage]
    run(real_log=log, task=str(SLIDER), out=tmp_path / "o", starts=1, threads=1)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == f"{stage}: 0 s, reading the log"
    step = "step 1 of 5, " if stage == "identify" else ""
    assert f"{stage}: 0 s, {step}making the log ready" in lines
    assert all(
        re.match(rf"{stage}: \d+ s, \S", line) for line in lines if not line.startswith(("warning", "  "))
    )


def test_identify_names_the_round_and_the_whole(log, tmp_path, monkeypatch, without_pages):
    said = []
    show = Progress._show
    monkeypatch.setattr(Progress, "_show", lambda self: (said.append(self.said()), show(self)))
    identify_stage.identify(
        real_log=log, task=str(SLIDER), out=tmp_path / "o", starts=1, threads=1, quiet=True, rounds=7
    )
    assert said[:2] == ["reading the log", "step 1 of 5, making the log ready"]
    assert "step 3 of 5, fit, round 1 of at most 7" in said
    assert any(
        re.fullmatch(r"step 3 of 5, fit, round 2 of at most 7, error \S+ x noise floor", s) for s in said
    )
    steps = [re.match(r"step (\d) of 5, ", s)[1] for s in said[1:]]
    assert steps == sorted(steps)
    assert set(steps) == set("12345")


def test_diagnose_names_the_effect_that_is_looked_for(monkeypatch):
    """Effects at several places are one; where as many are found as may be, what follows is of none."""
    said = []

    def explain(_prepared, _nominal, _settings, tell, _as_held) -> None:
        said.append(progress.said())
        for number, found in ((0, []), (0, ["drag@a", "drag@b"]), (1, ["drag@a", "drag@b", "hum@a"])):
            tell("score", number, 9, found)
            said.append(progress.said())
        raise KeyboardInterrupt

    monkeypatch.setattr(diagnose_stage, "explain", explain)
    progress = Progress("diagnose", "model", quiet=True)
    with pytest.raises(Interrupted):
        diagnose_stage.diagnose_prepared(None, None, Settings(most_effects=2), progress)
    assert said == [
        "fitting the declared model",
        "effect 1 of at most 2, score 1 of 9",
        "effect 2 of at most 2, score 1 of 9; found drag@a, drag@b",
        "score 2 of 9; found drag@a, drag@b, hum@a",
    ]
