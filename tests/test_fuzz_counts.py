"""What the benchmark of hostile inputs makes of what its workers tell."""

from __future__ import annotations

import json

import pytest

from benchmarks import fuzz
from benchmarks.base import measure
from benchmarks.fuzz import Fuzz


def row(**changes) -> dict:
    told = {"kind": "csv", "label": "csv 0-0-0", "seed": False, "known": False, "arguments": ["inspect"]}
    return {**told, "code": 2, "seconds": 0.1, "memory": 10**8, "faults": [], **changes}


@pytest.fixture
def counted(tmp_path, monkeypatch):
    """What is written of these rows, of a run of 0.03 minutes."""

    def count(*told: dict) -> dict:
        monkeypatch.setattr(fuzz, "rows", lambda *_: iter(told))
        _, path = measure("fuzz", Fuzz(logs=0, folder=tmp_path, minutes=0.03))
        return json.loads(path.read_text())

    return count


def test_inputs_are_counted_by_kind_and_end(counted):
    document = counted(
        row(code=0, seconds=3.0),
        row(seed=True, known=True),
        row(kind="model", memory=2 * 10**8),
    )
    values = {f["name"].strip(): f["value"] for f in document["figures"]}
    assert values["hostile inputs"] == 3 and values["whose end is known"] == 1
    assert values["that end with 0"] == 1 and values["that end with 2"] == 2
    assert (
        values["longest run on a hostile input"] == 3.0 and values["most memory for a hostile input"] == 0.2
    )
    assert document["details"]["kinds"]["csv"] == {
        "inputs": 2,
        "seeds": 1,
        "known": 1,
        "codes": {"0": 1, "2": 1},
        "faults": 0,
        "longest_s": 3.0,
        "most_bytes": 10**8,
    }
    assert all(f["met"] in (True, None) for f in document["figures"])


def test_what_does_not_end_as_it_has_to_is_a_figure_that_is_not_met(counted):
    document = counted(row(), row(), row(code=1, faults=[["exit code", "1"], ["traceback", "it said"]]))
    not_met = {f["name"]: f["value"] for f in document["figures"] if f["met"] is False}
    assert not_met == {
        "hostile inputs with other exit codes than 0 and 2": 1,
        "with a traceback, or a warning of Python's": 1,
    }
    (kept,) = document["details"]["faults"]
    assert kept["label"] == "csv 0-0-0" and kept["code"] == 1


def test_too_few_inputs_are_not_enough(counted):
    document = counted(row())
    assert [f["name"] for f in document["figures"] if f["met"] is False] == ["hostile inputs"]
