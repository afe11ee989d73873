"""A small part of the planted-effect benchmark, and how it sizes effects, judges and sums up."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from benchmarks import MACHINES, planted
from benchmarks._planted import pages, results
from benchmarks._planted.cases import (
    LEFT,
    MAGNITUDES,
    NO_SIZE,
    NOISE,
    NOTHING,
    PAIR,
    PAIRS,
    PLANTED,
    UNKNOWN,
    Case,
    cases,
    direction,
    experiment,
    size,
)
from benchmarks._planted.diagnosing import diagnose, line
from benchmarks._planted.machines import MACHINE, Experiment
from benchmarks._planted.outcomes import EQUIVALENTS, judge
from benchmarks._planted.outside import OUTSIDE
from benchmarks._planted.summary import confusion, summary
from benchmarks._share import share
from capture_cli.effects import REGISTRY
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.tasks import load_task

EPISODES = 6  # rather than twelve, for the time it takes
# of bodies that fly, and of sensors of forces: none of the machines has any
NO_PLACE = {
    "ground-effect",
    "magnus-lift",
    "sensor-high-pass",
    "sensor-mount-rotation",
    "sensor-saturation",
    "site-shift",
}
OBVIOUS = {
    Case(PLANTED, "slider", "coulomb-friction", "x", 10.0, 0): 0.08,
    Case(PLANTED, "slider", "cubic-stiffness", "x", 10.0, 0): 0.6,
    Case(PLANTED, "slider", "control-saturation", "drive", 10.0, 0): 0.25,
}


@pytest.mark.parametrize("case", OBVIOUS, ids=lambda c: c.effect)
def test_an_obvious_effect_is_found_and_nothing_else(case):
    row = line(case, OBVIOUS[case], EPISODES)
    assert row["before"]["test"] > 3, "the effect is not obvious"
    assert row["outcome"] == "exact", row["found"]
    assert row["after"]["test"] < 1.2


@pytest.mark.parametrize("name", OUTSIDE)
def test_an_effect_outside_the_catalogue_can_be_simulated_and_shows(name):
    made, (plant,) = experiment(Case(UNKNOWN, "slider", name, "x", 10.0, 0), 1)
    assert np.abs(made.log([(plant.effect, plant.values(0.5))]).outputs - made.log().outputs).max() > 0


def test_steps_that_are_too_long_are_found(tmp_path):
    made = Experiment(MACHINE["arm"], np.random.default_rng(0), episodes=3)
    effect = REGISTRY.get("finer-time-step")(made.task.model, "quarter")
    made.log([(effect, np.zeros(0))]).write(tmp_path / "log.zarr")
    document = diagnose(MeasuredLog.read(tmp_path / "log.zarr"), made.task, seed=0)
    assert [(e["name"], e["site"]) for e in document["effects"]] == [("finer-time-step", "quarter")]
    assert document["verdict"] == "effect-found"
    assert document["before"]["test"]["normalized"] > 10 > 1.2 > document["after"]["test"]["normalized"]


@pytest.mark.parametrize("machine", ["slider", "cart_pole"])
def test_nothing_is_found_where_nothing_is_missing(machine):
    row = line(Case(NOTHING, machine, "", "", 1.0, 0), episodes=EPISODES)
    assert row["outcome"] == "silent", row["found"]


def test_an_effect_that_moves_no_output_is_nothing_to_find():
    row = line(Case(PLANTED, "slider", "gravity-magnitude", "", 3.0, 0), episodes=EPISODES)
    assert row["outcome"] == "absorbed"
    assert row["left_at_most"] < 0.5


def test_cases_cover_catalogue_and_machines():
    every = list(cases(seeds=1, logs=8))
    assert len(set(every)) == len(every)
    assert len([c for c in every if c.kind == NOTHING]) == 8
    planted = {c.effect for c in every if c.kind == PLANTED}
    assert planted == {n for n in REGISTRY.names() if n not in (*NO_PLACE, *NO_SIZE, *NOISE)}
    assert {c.effect for c in every if c.kind == UNKNOWN} == set(OUTSIDE)
    assert {c.machine for c in every if c.kind == LEFT} == {c.machine for c in every}
    assert {c.magnitude for c in every if c.kind == PLANTED} == set(MAGNITUDES)
    pairs = [c for c in every if c.kind == PAIR]
    assert len(pairs) == PAIRS * len(MACHINE)
    assert all(c.effect != c.second.split("@")[0] for c in pairs)


@pytest.mark.parametrize("machine", ["slider", "cart_pole", "arm", "pan_tilt", "finger", "puck"])
def test_directions_stay_within_ranges(machine):
    model = load_task(str(MACHINES / machine / "task.toml")).model
    sited = [(name, cls) for name, cls in REGISTRY.items() if name not in NO_SIZE and cls.sites(model)]
    assert len(sited) >= 40
    for name, cls in sited:
        for site in cls.sites(model):
            effect = cls(model, site)
            values = direction(effect, np.random.default_rng(0))
            shapes = [effect.space.names.index(n) for n in effect.shapes if n in effect.space.names]
            amplitudes = np.setdiff1d(np.arange(len(effect.space)), shapes)
            np.testing.assert_array_equal(values(0.0)[amplitudes], effect.space.nominal[amplitudes], name)
            largest = values(1.0)
            assert np.all((largest >= effect.space.low) & (largest <= effect.space.high)), name


@pytest.mark.parametrize("power", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("magnitude", MAGNITUDES)
def test_size_reaches_the_error_asked_for(power, magnitude):
    found = size(lambda s: 40.0 * s**power, magnitude)
    assert 40.0 * found**power == pytest.approx(np.sqrt(magnitude**2 - 1), rel=0.15)


def test_size_out_of_reach_and_beyond_divergence():
    assert size(lambda s: 0.2 * s, 3.0) is None
    found = size(lambda s: 1000.0 * s if s < 0.02 else np.inf, 3.0)
    assert 1000.0 * found == pytest.approx(np.sqrt(8), rel=0.15)


def effect(name: str, site: str = "", tied: tuple[str, ...] = ()) -> dict:
    return {"name": name, "site": site, "tied_with": list(tied)}


@pytest.mark.parametrize(
    ("verdict", "effects", "outcome"),
    [
        ("effect-found", [effect("constant-force", "x")], "exact"),
        ("effect-found", [effect("cogging", "x"), effect("constant-force", "x")], "among others"),
        ("tied", [effect("cogging", "x", ("constant-force@x",))], "tied"),
        ("effect-found", [effect("spring-preload", "x")], "equivalent"),
        ("effect-found", [effect("cogging", "x")], "wrong"),
        ("unexplained", [effect("cogging", "x")], "unexplained"),
        ("unexplained", [effect("cogging", "x"), effect("constant-force", "x")], "unexplained"),
        ("explained", [], "missed"),
    ],
)
def test_outcomes_of_a_planted_effect(verdict, effects, outcome):
    case = Case(PLANTED, "slider", "constant-force", "x", 3.0, 0)
    assert judge(case, verdict, effects, 1.0) == outcome


@pytest.mark.parametrize(
    ("verdict", "effects", "outcome"),
    [
        ("effect-found", [effect("coulomb-friction", "x"), effect("constant-force", "x")], "exact"),
        ("effect-found", [effect("constant-force", "x"), effect("coulomb-friction", "x")], "exact"),
        ("effect-found", [effect("spring-preload", "x"), effect("coulomb-friction", "x")], "equivalent"),
        (
            "tied",
            [effect("cogging", "x", ("constant-force@x",)), effect("coulomb-friction", "x")],
            "tied",
        ),
        ("effect-found", [effect("coulomb-friction", "x")], "one of two"),
        ("effect-found", [effect("load-dependent-friction", "x")], "wrong"),
        ("unexplained", [effect("coulomb-friction", "x")], "unexplained"),
        ("explained", [], "missed"),
    ],
)
def test_outcomes_of_two_at_once(verdict, effects, outcome):
    case = Case(PAIR, "slider", "constant-force", "x", 3.0, 0, "coulomb-friction@x")
    assert judge(case, verdict, effects, 1.0) == outcome


def test_two_at_once_are_two_and_both_show():
    case = Case(PAIR, "slider", "cubic-drag", "x", 3.0, 0, "gravity-tilt")
    assert case.label == "pair/slider/cubic-drag@x&gravity-tilt/3/0"
    made, plants = experiment(case, episodes=1)
    nothing = made.log().outputs
    alone = [(plant.effect, plant.values(0.3)) for plant in plants]
    moved = [np.abs(made.log(planted).outputs - nothing).max() for planted in ([alone[0]], [alone[1]], alone)]
    assert len(plants) == 2
    assert min(moved) > 0
    assert moved[2] not in moved[:2]


def test_outcomes_without_a_planted_effect():
    nothing = Case(NOTHING, "slider", "", "", 1.0, 0)
    assert judge(nothing, "explained", [], 1.0) == "silent"
    assert judge(nothing, "effect-found", [effect("cogging", "x")], 1.0) == "false alarm"
    assert judge(nothing, "unexplained", [], 1.3) == "false alarm"
    unknown = Case(UNKNOWN, "slider", "ratchet", "x", 3.0, 0)
    assert judge(unknown, "unexplained", [effect("cogging", "x")], 2.0) == "honest"
    assert judge(unknown, "effect-found", [effect("cogging", "x")], 1.1) == "imitated"
    assert judge(unknown, "effect-found", [effect("cogging", "x")], 2.0) == "wrong"
    assert judge(unknown, "explained", [], 2.0) == "missed"


def test_equivalents_are_candidates_of_their_machine():
    for e in EQUIVALENTS:
        model = load_task(str(MACHINES / e.machine / "task.toml")).model
        known = {n + (f"@{s}" if s else "") for n, cls in REGISTRY.items() for s in cls.sites(model)}
        assert e.planted | e.found <= known, e.machine


def row(case: Case, outcome: str, found: str | None, error: float) -> dict:
    accepted = [] if found is None else [{"effect": found, "tied_with": [], "values": {}}]
    return {
        **asdict(case),
        "code": "c",
        "outcome": outcome,
        "verdict": "effect-found" if found else "explained",
        "found": accepted,
        "before": {"test": error},
        "after": {"test": 1.0 if outcome == "exact" else error},
        "floor_over_noise": [1.0],
        "seconds": 2.0,
        "cpu_seconds": 1.0,
        "rollouts": 10,
    }


def test_summary_counts_what_is_visible(tmp_path):
    small = Case(PLANTED, "slider", "cogging", "x", 1.5, 0)
    large = Case(PLANTED, "slider", "cogging", "x", 10.0, 0)
    null = Case(NOTHING, "slider", "", "", 1.0, 0)
    rows = [
        row(small, "missed", None, 1.4),
        row(large, "exact", "cogging@x", 9.0),
        row(null, "silent", None, 1.0),
        {**asdict(large), "code": "c", "effect": "wind", "outcome": "absorbed"},
    ]
    found = summary(rows)
    assert (found["right_where_visible"]["hits"], found["right_where_visible"]["of"]) == (1, 1)
    assert found["power"]["1.5"]["share"] == 0.0
    assert found["power"]["10"]["share"] == 1.0
    assert found["power"]["3"] is None
    assert found["false_alarms"]["of"] == 1
    assert found["nothing_to_find"] == ["slider: wind@x"]
    planted, names, counts = confusion(rows[:2])
    assert (planted, names) == (["cogging"], ["cogging", "(nothing)"])
    assert counts.tolist() == [[1, 1]]
    pages.write(rows, found, tmp_path)
    assert "| `cogging` | 2 | 1 | (nothing) 1 |" in (tmp_path / "confusion.md").read_text()
    assert {p.name for p in tmp_path.iterdir()} == {"confusion.md", "confusion.png", "power.png"}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--only", "sliderr"], "error: --only 'sliderr' matches none of"),
        (["--only", "("], "error: --only '(' is no regular expression: missing )"),
        (["--summary"], "holds no line of a finished log"),
    ],
)
def test_nothing_to_do_is_said_and_nothing_written(monkeypatch, capsys, tmp_path, options, said):
    monkeypatch.setattr(sys, "argv", ["planted", *options, "--out", str(tmp_path)])
    with pytest.raises(SystemExit, match="2"):
        planted.main()
    err = capsys.readouterr().err
    assert said in err
    assert (
        "--summary" in options or f"KIND/MACHINE/EFFECT@SITE/ERROR/SEED, for example {planted.EXAMPLE}" in err
    )
    assert not list(tmp_path.iterdir())
    assert planted.EXAMPLE in {c.label for c in cases(1, 0)}


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_workers_end_with_who_started_them(number):
    """A worker that lives on holds stdout open, and `run` waits for it."""
    code = f"""
import os, signal, time
from benchmarks._planted.results import workers
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
with workers(1) as pool:
    pool.submit(os.getpid).result()
    pool.submit(time.sleep, 300)
    time.sleep(0.5)
    os.kill(os.getpid(), {int(number)})
    time.sleep(300)
"""
    ended = subprocess.run(
        [sys.executable, "-c", code], cwd=MACHINES.parents[1], capture_output=True, timeout=60
    )
    assert ended.returncode != 0


def test_share_has_the_exact_interval():
    # Clopper & Pearson: none of 200 leaves 1 - 0.025 ** (1 / 200)
    assert share(0, 200)["high"] == pytest.approx(1 - 0.025 ** (1 / 200))
    assert share(0, 0) is None


def test_lines_of_other_code_and_half_lines_are_not_read(tmp_path):
    (tmp_path / "results.jsonl").write_text(
        '{"code": "a", "seed": 1}\n{"code": "b", "seed": 2}\n{"code": "a", "se'
    )
    assert [r["seed"] for r in results.rows(tmp_path, "a")] == [1]
    assert results.newest_code(tmp_path) == "b"


def test_a_case_finished_after_a_line_was_cut_off_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(results, "workers", ThreadPoolExecutor)
    monkeypatch.setattr(results, "_try", lambda case, size: {"outcome": "right"})
    some = list(cases(1, 0))[:2]
    results.add(some[:1], tmp_path, jobs=1)
    path = tmp_path / "results.jsonl"
    path.write_text(path.read_text()[:-20])  # killed while writing
    results.add(some[1:], tmp_path, jobs=1)
    assert [r["effect"] for r in results.rows(tmp_path, None)] == [some[1].effect]


def test_of_a_log_the_newest_line_counts(tmp_path):
    lines = [("a", 1), ("b", 1), ("a", 2), ("c", 2), ("b", 3)]
    text = "".join(json.dumps({"code": code, "seed": seed}) + "\n" for code, seed in lines)
    (tmp_path / "results.jsonl").write_text(text)
    told = [[(r["code"], r["seed"]) for r in results.newest(tmp_path, versions)] for versions in (1, 2, 3)]
    assert told == [[("b", 1), ("b", 3)], [("b", 1), ("c", 2), ("b", 3)], [("b", 1), ("c", 2), ("b", 3)]]


def test_the_summary_that_is_shipped_is_of_the_newest_lines():
    folder = Path(__file__).parents[1] / "runs" / "planted"
    shipped = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert shipped["code"] == results.newest_code(folder)
    assert shipped["logs"] == len(results.newest(folder, shipped["versions"]))
