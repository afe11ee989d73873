"""Runs that are killed at random: a few of those of the benchmark; and that it sees what it is to see."""

from __future__ import annotations

import signal
import sys

import pytest

from benchmarks._kills.killing import NOTHING, Reference, kill
from benchmarks._kills.runs import RUNS, Run
from benchmarks._kills.sameness import contents, differences
from benchmarks.kills import kill_at_random

QUICK = ["record"]


def test_killed_runs_leave_no_output_in_part_and_say_what_is_true():
    outcomes = kill_at_random(3, QUICK)
    assert len(outcomes) == 3 and {o.command for o in outcomes} == set(QUICK)
    assert {o.signal for o in outcomes} == {"SIGKILL", "SIGTERM", "SIGINT"}
    assert [o for o in outcomes if o.faults] == []


def test_every_command_is_killed():
    from capture_cli.cli.app import _COMMANDS

    assert {run.arguments[0] for run in RUNS.values()} == set(_COMMANDS)


# A command that does as it is told: what it writes, what it does when it is interrupted.
UNTRUE = """
import signal, sys, time
from pathlib import Path

def end(number, _):
    print(sys.argv[2], file=sys.stderr)
    sys.exit(int(sys.argv[3]))

signal.signal(signal.SIGTERM, end)
if sys.argv[1] != "nothing":
    Path("out").write_text(sys.argv[1])
time.sleep(30)
"""
SAID = "interrupted: nothing was written\n  cure: run the same command again"


@pytest.mark.parametrize(
    ("writes", "says", "code", "fault"),
    [
        ("half", SAID, 143, "out is there in part"),
        ("whole", SAID, 143, "nothing was written, but there are"),
        ("nothing", "interrupted when all was written: out", 143, "all was written, but whole are []"),
        ("nothing", "interrupted: all of it is kept; --resume", 143, "kept is ''"),
        ("nothing", "", 143, "exit code 143"),
        ("nothing", SAID, 1, "exit code 1"),
    ],
)
def test_what_is_not_as_it_has_to_be_is_seen(tmp_path, monkeypatch, writes, says, code, fault):
    monkeypatch.setattr("benchmarks._kills.killing._run_again", lambda *_: [])
    program = tmp_path / "untrue.py"
    program.write_text(UNTRUE)
    made = Reference({"out": {"out": b"whole"}}, "", 1.0)
    capture = [sys.executable, str(program), writes, says, str(code)]
    outcome = kill(Run("out", ["out"]), made, tmp_path / "run", signal.SIGTERM, 1.0, capture)
    assert fault in "; ".join(outcome.faults)


def test_what_is_as_it_has_to_be_is_no_fault(tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks._kills.killing._run_again", lambda *_: [])
    (tmp_path / "true.py").write_text(UNTRUE)
    made = Reference({"out": {"out": b"whole"}}, "", 1.0)
    capture = [sys.executable, str(tmp_path / "true.py"), "nothing", SAID, "143"]
    outcome = kill(Run("out", ["out"]), made, tmp_path / "run", signal.SIGTERM, 1.0, capture)
    assert (outcome.ended, outcome.faults) == (NOTHING, [])


def test_times_alone_are_not_compared(tmp_path):
    for name, seconds, value in (("a", 1, 2), ("b", 3, 2), ("c", 1, 4)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "provenance.json").write_text(f'{{"seconds": {seconds}, "value": {value}}}')
    a, b, c = (contents(tmp_path / name) for name in "abc")
    assert differences(a, b) == [] and differences(a, c) == ["provenance.json"]
    assert differences(None, a) == ["provenance.json"] and differences(None, None) == []
