"""The rule sees what it is to see: a `capture` that does as it is told, and what is wrong with that."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from fuzz import forked_run
from fuzz.cases import Case, refused, taken
from fuzz.drawing import draw
from fuzz.forked_run import CAN_RUN
from fuzz.kept import keep, read
from fuzz.mutations import Raw, json_text, toml_text
from fuzz.trial import attempt

pytestmark = pytest.mark.skipif(not CAN_RUN, reason="processes are copied on Linux alone")
CURE = "  cure: mend it"


def ends(code: int, *, out: str = "", err: str = "", writes: dict[str, str] | None = None, does: str = ""):
    """A `capture` that writes and says this, does that, and ends so."""

    def main(_arguments) -> int:
        exec(does)
        for name, content in (writes or {}).items():
            Path(name).parent.mkdir(parents=True, exist_ok=True)
            Path(name).write_text(content)
        sys.stdout.write(out)
        sys.stderr.write(err)
        return code

    return main


SOUND = ends(2, err=f"a warning\nerror: that is wrong\n{CURE}\n")
WHOLE = {"out/provenance.json": "{}", "out/data": "1"}


@pytest.mark.parametrize(
    ("main", "case", "fault"),
    [
        (SOUND, Case(("x",)), None),
        (SOUND, Case(("x",), expected=refused("is wrong")), None),
        (ends(0, writes=WHOLE), Case(("x",), outputs=("out",), expected=taken()), None),
        (ends(0, out="{}"), Case(("x", "--json")), None),
        (ends(0, out="capture 0.1"), Case(("--version", "x", "--json")), None),
        (ends(0, out="Usage: capture"), Case(("x", "--json", "--help")), None),
        (ends(3), Case(("x", "--fail-on", "y")), None),
        (ends(2, out="error  store: bad\n       mend it\n"), Case(("inspect", "x")), None),
        (ends(1), Case(("x",)), "exit code"),
        (ends(3), Case(("x",)), "exit code"),
        (ends(0, does="import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"), Case(("x",)), "exit code"),
        (ends(0, does="import time; time.sleep(9)"), Case(("x",)), "hang"),
        (ends(0, does="x = b'x' * (1 << 30)"), Case(("x",)), "memory"),
        (ends(2, err=f"error: out of memory\n{CURE}"), Case(("x",)), "memory"),
        (ends(0, does="[][0]"), Case(("x",)), "traceback"),
        (ends(2, err=f"a.py:3: RuntimeWarning: overflow\nerror: a\n{CURE}"), Case(("x",)), "traceback"),
        (ends(2, err=f"error: {'a' * 1000}\n{CURE}"), Case(("x",)), "message"),
        (ends(2, err="error: that is wrong"), Case(("x",)), "message"),
        (ends(2, err=f"error: a\n{CURE}\nafterwards"), Case(("x",)), "message"),
        (ends(2), Case(("x",)), "message"),
        (ends(2, out="error  store: bad\n"), Case(("inspect", "x")), "message"),
        (
            ends(2, err=f"error: a\n{CURE}", writes={"new": "1"}),
            Case(("x",), outputs=("new",)),
            "left behind",
        ),
        (
            ends(2, err=f"error: a\n{CURE}", writes={"given": "2"}),
            Case(("x",), files={"given": b"1"}),
            "left behind",
        ),
        (ends(2, err=f"error: a\n{CURE}", writes={"../temporary/a": "1"}), Case(("x",)), "left behind"),
        (ends(0, writes={"new": "1"}), Case(("x",)), "left behind"),
        (
            ends(0, does="import os, time; os.fork() or (os.closerange(0, 3), time.sleep(9))"),
            Case(("x",)),
            "left behind",
        ),
        (ends(0), Case(("x",), outputs=("out",)), "wrong end"),
        (ends(0, writes={"out/data": "1"}), Case(("x",), outputs=("out",)), "wrong end"),
        (ends(0, writes={"out.json": "{"}), Case(("x",), outputs=("out.json",)), "wrong end"),
        (ends(0, out="{"), Case(("x", "--json")), "wrong end"),
        (ends(0, out="capture 0.1"), Case(("x", "--version", "--json")), "wrong end"),
        (ends(0), Case(("x",), expected=refused()), "wrong end"),
        (SOUND, Case(("x",), expected=taken()), "wrong end"),
        (SOUND, Case(("x",), expected=refused("is right")), "wrong end"),
    ],
)
def test_what_does_not_keep_to_the_rule_is_seen(tmp_path, monkeypatch, main, case, fault):
    from fuzz import rule

    monkeypatch.setattr(forked_run, "_main", main)
    # beyond what this process has itself, of which a fork of it begins with as much
    monkeypatch.setattr(rule, "MOST_MEMORY", 1 << 30)
    monkeypatch.setattr(
        forked_run.run, "__kwdefaults__", {"enter": None, "seconds": 4.0}
    )  # to fill a GiB, on a busy machine
    outcome = attempt(case, tmp_path, tmp_path / "place")
    assert {kind for kind, _ in outcome.faults} >= ({fault} if fault else set())
    assert bool(outcome.faults) is bool(fault), outcome.faults
    assert list(tmp_path.iterdir()) == []


def test_a_case_that_was_kept_is_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(forked_run, "_main", SOUND)
    files = {"a/b": b"\xff\0", "c": None}
    (tmp_path / "inputs").mkdir()
    (tmp_path / "inputs" / "c").write_text("1")
    case = Case(("x", "\udcff"), ("c",), files, ("out",), taken("a"))
    outcome = attempt(case, tmp_path / "inputs", tmp_path / "place")
    keep(outcome, "csv", tmp_path / "kept")
    assert json.loads((tmp_path / "kept" / "case.json").read_text())["faults"]
    assert read(tmp_path / "kept", tmp_path / "inputs") == case


def test_what_is_drawn_is_the_same_for_the_same_number():
    from hypothesis import strategies as st

    numbers = st.integers(0, 10**6).map(lambda n: Case((str(n),)))
    first, again, other = draw(numbers, 1, 20), draw(numbers, 1, 20), draw(numbers, 2, 20)
    assert first == again != other and len(first) == 20


def test_documents_are_written_as_they_are_meant():
    import tomllib

    document = {"a b": [1, {"c": "\n"}], "d": {"e": 1.5, "f": {}}}
    assert json.loads(json_text(document)) == document
    assert tomllib.loads(toml_text(document)) == document
    assert json_text({"a": Raw("9" * 400)}) == f'{{"a": {"9" * 400}}}'
