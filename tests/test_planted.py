"""The planted-effect benchmark: how it asks, judges, freezes, draws, sums up and compares."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from case_logs import log_of
from diagnosing import diagnose, look_among

from benchmarks import MACHINES, ROOT, chain, planted
from benchmarks._planted import asking
from benchmarks._planted import rows as rows_module
from benchmarks._planted.asking import Answer, ask
from benchmarks._planted.frozen import capture_hash, freeze
from benchmarks._planted.outcomes import EQUIVALENTS, RIGHT, judge, placed
from benchmarks._planted.rows import FAILED, NOTHING_TO_FIND, Draw, add, draws, key, read, row_of
from benchmarks._planted.summary import compare, figures, page, summary
from benchmarks._planted_logs.cases import (
    LEFT,
    MAGNITUDES,
    NOTHING,
    PAIR,
    PLANTED,
    UNKNOWN,
    WEAK,
    Case,
    cases,
)
from benchmarks._planted_logs.dresses import FILTERED, HALF, NO_WINDOW, PLAIN
from benchmarks._planted_logs.machines import MACHINE, Experiment
from benchmarks._planted_logs.outside import OUTSIDE
from benchmarks._share import share
from capture_cli.errors import OptionError
from capture_cli.estimate.balance.screening import Addition
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.effects import REGISTRY
from capture_cli.model.tasks import load_task
from capture_cli.select.search.extension import Extension

# what steps that are too long could be taken for
BESIDE_STEPS = ("viscous-damping", "coulomb-friction", "reflected-inertia", "sensor-delay")
EPISODES = 4  # rather than twelve, for the time it takes
FRICTION = Case(PLANTED, "slider", ("coulomb-friction@x",), 3.0, 0, episodes=EPISODES)
CONSTANT = Case(PLANTED, "slider", ("constant-force@x",), 3.0, 0)


# --- asking ---


def test_an_obvious_effect_is_found_and_not_where_the_catalogue_is_without_it():
    row = row_of(FRICTION, ROOT)
    assert (row["outcome"], row["verdict"]) == ("exact", "effect-found"), row
    assert row["after"] < 1.2
    truth, found = row["effects"]["coulomb-friction@x"], row["found"][0]["values"]
    assert found == pytest.approx(truth, rel=0.1)
    assert 0 < row["cpu_seconds"] < 2 * row["seconds"]


def test_an_effect_that_is_hidden_is_in_no_catalogue():
    effects = asking._effects_of(Path(__file__).resolve().parents[1])
    text = subprocess.run(
        [sys.executable, "-c", asking._CAPTURE, effects, "payload wind", "effects", "--json"],
        capture_output=True,
        text=True,
    ).stdout
    assert {"payload", "wind", "cogging"} <= set(REGISTRY.names())
    assert [name in text for name in ("payload", '"wind"', "cogging")] == [False, False, True]


@pytest.fixture
def stub(tmp_path):
    """A version with a catalogue, and no command yet."""
    (tmp_path / "capture_cli" / "effects").mkdir(parents=True)
    (tmp_path / "capture_cli" / "__init__.py").touch()
    (tmp_path / "capture_cli" / "effects" / "__init__.py").write_text(
        "class REGISTRY:\n    not_listed = ('base',)\n"
    )
    return tmp_path


def test_the_files_that_are_asked_about_are_those_of_the_dress(stub):
    task, log = log_of(replace(FRICTION, dress=NO_WINDOW), 0.048)
    (stub / "capture_cli" / "cli.py").write_text(
        "import json, os, sys\nfrom pathlib import Path\nfrom capture_cli.effects import REGISTRY\n"
        "def main():\n"
        "    print(json.dumps([Path('task.toml').read_text(), sys.argv, REGISTRY.not_listed]))\n"
    )
    text, argv, hidden = ask(task, log, stub, seed=7, hidden=["payload"]).document
    assert "window" not in text
    assert text == "".join(
        line
        for line in task.path.read_text(encoding="utf-8").splitlines(keepends=True)
        if not line.startswith("window")
    )
    assert argv[1:8] == ["diagnose", "--real-log", "log.zarr", "--task", "task.toml", "--out", "out"]
    assert hidden == ["base", "payload"]


def test_a_diagnosis_that_fails_is_a_row(stub):
    (stub / "capture_cli" / "cli.py").write_text(
        "def main():\n    raise SystemExit('error: no, not this one')\n"
    )
    row = row_of(FRICTION, stub)
    assert (row["outcome"], row["why"].splitlines()[0]) == (FAILED, "error: no, not this one")
    assert str(stub) not in json.dumps(row)


def test_what_shows_nothing_is_not_asked_about(tmp_path):
    row = row_of(Case(PLANTED, "slider", ("gravity-magnitude",), 3.0, 0), tmp_path)
    assert row["outcome"] == NOTHING_TO_FIND
    assert "at most 1 times the noise" in row["why"]


@pytest.mark.parametrize("name", OUTSIDE)
def test_an_effect_outside_the_catalogue_can_be_simulated_and_shows(name):
    made = Experiment(MACHINE["slider"], np.random.default_rng(0), 1)
    (effect,) = Case(UNKNOWN, "slider", (f"{name}@x",), 3.0, 0).effects(made.task.model)
    size = effect.space.nominal + 0.5 * (effect.space.high - effect.space.nominal)
    assert np.abs(made.outputs([(effect, size)]) - made.outputs()).max() > 0


def test_steps_that_are_too_long_are_found(tmp_path, monkeypatch):
    look_among(monkeypatch, "finer-time-step", *BESIDE_STEPS)
    monkeypatch.setattr(Extension, "_balance_round", lambda *_: pytest.fail("steps are asked first"))
    made = Experiment(MACHINE["arm"], np.random.default_rng(0), episodes=2)
    effect = REGISTRY.get("finer-time-step")(made.task.model, "quarter")
    made.log(made.outputs([(effect, np.zeros(0))])).write(tmp_path / "log.zarr")
    document = diagnose(MeasuredLog.read(tmp_path / "log.zarr"), made.task, seed=0)
    assert [(e["name"], e["site"]) for e in document["effects"]] == [("finer-time-step", "quarter")]
    assert document["verdict"] == "effect-found"
    assert document["before"]["test"]["normalized"] > 10 > 1.2 > document["after"]["test"]["normalized"]


@pytest.mark.parametrize(
    ("case", "sizes", "found"),
    [
        (Case(WEAK, "slider", ("quadratic-drag@x",), 1.04, 0), [0.135], ["quadratic-drag@x"]),
        (Case(NOTHING, "slider", (), 1.0, 0), [], []),
    ],
)
def test_where_the_balance_is_not_sure_an_explained_log_is_asked_by_simulation(
    tmp_path, monkeypatch, case, sizes, found
):
    look_among(monkeypatch, "quadratic-drag", "coulomb-friction", "control-delay")
    monkeypatch.setattr(Addition, "is_sure", lambda *_: False)
    task, log = log_of(case, *sizes)
    log.write(tmp_path / "log.zarr")
    said = diagnose(MeasuredLog.read(tmp_path / "log.zarr"), task, seed=0)
    assert said["before"]["test"]["normalized"] < 1.1
    assert [placed(e) for e in said["effects"]] == found


# --- judging ---


def effect(name: str, site: str = "", tied: tuple[str, ...] = ()) -> dict:
    return {"name": name, "site": site, "tied_with": list(tied)}


def document(verdict: str, effects: list[dict], error: float = 1.0, **more) -> dict:
    return {"verdict": verdict, "effects": effects, "after": {"test": {"normalized": error}}, **more}


@pytest.mark.parametrize(
    ("verdict", "effects", "outcome"),
    [
        ("effect-found", [effect("constant-force", "x")], "exact"),
        ("effect-found", [effect("cogging", "x"), effect("constant-force", "x")], "beside others"),
        ("effect-found", [effect("spring-preload", "x"), effect("cogging", "x")], "beside others"),
        ("tied", [effect("cogging", "x", ("constant-force@x",))], "tied"),
        ("effect-found", [effect("spring-preload", "x")], "equivalent"),
        ("effect-found", [effect("cogging", "x")], "wrong"),
        ("unexplained", [effect("constant-force", "x")], "unexplained"),
        ("unexplained", [], "unexplained"),
        ("explained", [], "missed"),
    ],
)
def test_outcomes_of_a_planted_effect(verdict, effects, outcome):
    assert judge(CONSTANT, document(verdict, effects)) == outcome
    assert (outcome in RIGHT) == (outcome in ("exact", "tied", "equivalent"))


@pytest.mark.parametrize(
    ("verdict", "effects", "outcome"),
    [
        ("effect-found", [effect("coulomb-friction", "x"), effect("constant-force", "x")], "exact"),
        ("effect-found", [effect("spring-preload", "x"), effect("coulomb-friction", "x")], "equivalent"),
        ("tied", [effect("cogging", "x", ("constant-force@x",)), effect("coulomb-friction", "x")], "tied"),
        (
            "effect-found",
            [effect("coulomb-friction", "x"), effect("constant-force", "x"), effect("cogging", "x")],
            "beside others",
        ),
        ("effect-found", [effect("coulomb-friction", "x")], "one of two"),
        ("effect-found", [effect("load-dependent-friction", "x")], "wrong"),
        ("unexplained", [effect("coulomb-friction", "x")], "unexplained"),
        ("explained", [], "missed"),
    ],
)
def test_outcomes_of_two_at_once(verdict, effects, outcome):
    case = Case(PAIR, "slider", ("constant-force@x", "coulomb-friction@x"), 3.0, 0)
    assert judge(case, document(verdict, effects)) == outcome


def test_an_effect_may_be_the_sum_of_two():
    case = Case(PAIR, "arm", ("constant-force@elbow", "linear-stiffness@elbow"), 3.0, 0)
    assert judge(case, document("effect-found", [effect("preloaded-spring", "elbow")])) == "equivalent"
    assert judge(case, document("effect-found", [effect("preloaded-spring", "shoulder")])) == "wrong"
    apart = replace(case, planted=("constant-force@elbow", "linear-stiffness@shoulder"))
    assert judge(apart, document("effect-found", [effect("preloaded-spring", "elbow")])) == "wrong"


def test_outcomes_without_a_planted_effect():
    nothing = Case(NOTHING, "slider", (), 1.0, 0)
    assert judge(nothing, document("explained", [])) == "silent"
    assert judge(nothing, document("effect-found", [effect("cogging", "x")])) == "false alarm"
    assert judge(nothing, document("unexplained", [], 1.3)) == "false alarm"
    unknown = Case(UNKNOWN, "slider", ("ratchet@x",), 3.0, 0)
    assert judge(unknown, document("unexplained", [effect("cogging", "x")], 2.0)) == "honest"
    assert judge(unknown, document("effect-found", [effect("cogging", "x")], 1.1)) == "imitated"
    assert judge(unknown, document("effect-found", [effect("cogging", "x")], 2.0)) == "wrong"
    assert judge(unknown, document("explained", [], 2.0)) == "missed"


def test_a_weak_effect_has_to_be_found():
    weak = replace(CONSTANT, kind=WEAK)
    assert judge(weak, document("effect-found", [effect("constant-force", "x")])) == "exact"
    assert judge(weak, document("explained", [])) == "missed"


def test_what_the_logger_does_to_its_sensors_may_be_named():
    named = [effect("sensor-low-pass", "q"), effect("constant-force", "x")]
    assert judge(CONSTANT, document("effect-found", named)) == "beside others"
    assert judge(replace(CONSTANT, dress=FILTERED), document("effect-found", named)) == "exact"
    nothing = Case(NOTHING, "slider", (), 1.0, 0, dress=FILTERED)
    assert judge(nothing, document("effect-found", named[:1])) == "silent"
    assert judge(nothing, document("effect-found", named)) == "false alarm"
    alike = [effect("control-lag", "drive"), effect("constant-force", "x")]
    assert judge(replace(CONSTANT, dress=FILTERED), document("effect-found", alike)) == "exact"
    tied = [effect("compliance", "x", tied=["sensor-low-pass@q"]), effect("constant-force", "x")]
    assert judge(replace(CONSTANT, dress=FILTERED), document("tied", tied)) == "exact"
    itself = Case(PLANTED, "slider", ("sensor-low-pass@q",), 3.0, 0, dress=FILTERED)
    assert judge(itself, document("effect-found", named[:1])) == "exact"


def test_equivalents_are_candidates_of_their_machine():
    for e in EQUIVALENTS:
        model = load_task(str(MACHINES / e.machine / "task.toml")).model
        known = {n + (f"@{s}" if s else "") for n, cls in REGISTRY.items() for s in cls.sites(model)}
        assert e.planted | e.found <= known, e.machine


# --- one version, one seed ---


@pytest.fixture
def checkout(tmp_path):
    """A version of which one file is enough."""
    root = tmp_path / "checkout"
    (root / "capture_cli").mkdir(parents=True)
    (root / "capture_cli" / "__init__.py").write_text("one = 1\n")
    return root


def test_a_seed_is_drawn_once(tmp_path, checkout):
    first = freeze(tmp_path / "a", checkout, None)
    assert first.sealed
    assert freeze(tmp_path / "a", checkout, None) == first
    assert freeze(tmp_path / "a", checkout, first.seed) == first
    assert freeze(tmp_path / "b", checkout, None).seed != first.seed
    assert not freeze(tmp_path / "c", checkout, 3).sealed


def test_rows_of_other_code_or_another_seed_are_refused(tmp_path, checkout):
    freeze(tmp_path / "a", checkout, 3)
    with pytest.raises(OptionError, match="the seed is 4, and was 3"):
        freeze(tmp_path / "a", checkout, 4)
    (checkout / "capture_cli" / "more.py").write_text("two = 2\n")
    with pytest.raises(OptionError, match="the version that is asked is"):
        freeze(tmp_path / "a", checkout, None)
    with pytest.raises(OptionError, match="holds no capture_cli"):
        capture_hash(tmp_path / "nowhere")


def test_code_that_makes_other_logs_is_refused(tmp_path, checkout):
    freeze(tmp_path, checkout, 3)
    path = tmp_path / "frozen.json"
    path.write_text(path.read_text().replace('"logs": "', '"logs": "0'))
    with pytest.raises(OptionError, match="the code that makes the logs is"):
        freeze(tmp_path, checkout, 3)


# --- drawing ---


def answered(case: Case, root) -> dict:
    """As though one in four had nothing to find."""
    empty = case.number % 4 == 0 and case.kind != NOTHING
    own = {k: getattr(case, k) for k in ("kind", "machine", "planted", "magnitude", "number", "dress")}
    return {
        **own,
        "outcome": NOTHING_TO_FIND if empty else "exact",
        "log": "l",
        "error": 3.0,
        "cpu_seconds": 2.0,
    }


@pytest.fixture
def unasked(monkeypatch):
    """Rows without logs; the cases that were asked about."""
    asked = []

    def row(case: Case, root) -> dict:
        asked.append(case)
        return answered(case, root)

    monkeypatch.setattr(rows_module, "workers", ThreadPoolExecutor)
    monkeypatch.setattr(rows_module, "row_of", row)
    return asked


def drawn(sample: int | None = None, seed: int = 1) -> list[Draw]:
    return draws({PLANTED: 20, NOTHING: 5}, seed, PLAIN, tuple(MACHINE), sample)


def test_so_many_are_asked_about_as_have_something_to_find(tmp_path, unasked):
    path = tmp_path / "plain.jsonl"
    add(drawn(), path, ROOT, jobs=2)
    found = read(path).values()
    countable = [r for r in found if r["outcome"] != NOTHING_TO_FIND]
    assert [sum(r["kind"] == k for r in countable) for k in (PLANTED, NOTHING)] == [20, 5]
    assert len(found) > 25
    # the first of each kind, whichever were ready first
    every = {key(vars(c)) for c in islice(cases(PLANTED, 1), len(found) - 5)}
    assert {key(r) for r in found if r["kind"] == PLANTED} == every


def test_a_run_goes_on_where_it_was_stopped(tmp_path, unasked):
    whole, path = tmp_path / "whole.jsonl", tmp_path / "plain.jsonl"
    add(drawn(), whole, ROOT, jobs=2)
    some = whole.read_text().splitlines(keepends=True)[:9]
    path.write_text("".join(some)[:-20])  # killed while writing
    unasked.clear()
    add(drawn(), path, ROOT, jobs=2)
    assert read(path).keys() == read(whole).keys()
    assert len(unasked) == len(read(whole)) - 8


def test_a_sample_is_of_the_same_cases(tmp_path, unasked):
    add(drawn(), tmp_path / "whole.jsonl", ROOT, jobs=2)
    add(drawn(sample=7), tmp_path / "some.jsonl", ROOT, jobs=2)
    whole, some = read(tmp_path / "whole.jsonl"), read(tmp_path / "some.jsonl")
    assert sum(r["outcome"] != NOTHING_TO_FIND for r in some.values()) == 7
    assert set(some) <= set(whole)


def test_cases_cover_catalogue_and_machines():
    every = {kind: list(islice(cases(kind, 0), 1200)) for kind in (PLANTED, PAIR, UNKNOWN, LEFT)}
    names = {p.partition("@")[0] for c in every[PLANTED] for p in c.planted}
    # of bodies that fly, and of sensors of forces: none of the machines has any; one has no size, one is noise
    assert set(REGISTRY.names()) - names == {
        "finer-time-step",
        "ground-effect",
        "magnus-lift",
        "sensor-high-pass",
        "sensor-mount-rotation",
        "sensor-quantisation",
        "sensor-saturation",
        "site-shift",
    }
    assert {c.magnitude for c in every[PLANTED]} == set(MAGNITUDES)
    assert {c.planted[0].partition("@")[0] for c in every[UNKNOWN]} == set(OUTSIDE)
    assert all(len({p.partition("@")[0] for p in c.planted}) == 2 for c in every[PAIR])
    assert {c.machine for c in every[LEFT]} == set(MACHINE)


# --- summing up ---


def row(case: Case, outcome: str, **more) -> dict:
    return {**answered(case, None), "outcome": outcome, "after": 1.0, "seconds": 3.0, "found": [], **more}


def many(kind: str, outcomes: str, dress: str = PLAIN, **more) -> list[dict]:
    """A row for each word of `outcomes`."""
    drawn = cases(kind, 0, dress)
    return [row(c, o.replace("_", " "), **more) for c, o in zip(drawn, outcomes.split(), strict=False)]


def test_the_summary_counts_each_kind():
    rows = [
        *many(PLANTED, "exact tied wrong failed nothing_to_find beside_others"),
        *many(PAIR, "exact one_of_two"),
        *many(NOTHING, "silent silent false_alarm"),
        *many(WEAK, "exact tied missed missed"),
        *many(UNKNOWN, "honest wrong"),
        *many(LEFT, "imitated missed"),
    ]
    del rows[3]["after"], rows[3]["cpu_seconds"]
    rows[2]["after"] = 1.3
    found = summary(rows)
    counted = {
        k: (found[k]["hits"], found[k]["of"])
        for k in ("right", "near_floor", "pairs", "false_alarms", "weak", "not_explained_away")
    }
    assert counted == {
        "right": (2, 5),
        "near_floor": (3, 5),
        "pairs": (1, 2),
        "false_alarms": (1, 3),
        "weak": (2, 4),
        "not_explained_away": (2, 4),
    }
    assert found["logs"] == len(rows) - 1
    assert found["cpu_seconds"] == 2.0
    told = figures(found, PLAIN)
    assert told[0].name == "plain: right, of one effect that doubles the floor (2 of 5; 5.3 to 85.3 %)"
    assert [f.met for f in told] == [False, False, False, False, False, False, None]


def test_the_page_lists_what_was_not_right():
    rows = many(PLANTED, "exact wrong", found=[{"effect": "cogging@x"}])
    text = page({PLAIN: rows})
    (line,) = [t for t in text.splitlines() if t.startswith("| plain")]
    assert line.endswith("| 3 | `cogging@x` | wrong |")
    assert all(e.why in text for e in EQUIVALENTS)


def by_key(rows: list[dict]) -> dict:
    return {key(r): r for r in rows}


def test_two_versions_side_by_side():
    a = many(PLANTED, "exact exact wrong wrong exact nothing_to_find exact") + many(NOTHING, "silent")
    b = many(PLANTED, "exact wrong tied exact exact exact missed", cpu_seconds=1.0) + many(NOTHING, "silent")
    b[6]["log"] = "another"
    del a[5]["log"]
    found = compare(by_key(a), by_key(b))
    assert found["kinds"][PLANTED] == {"both": 2, "only_a": 1, "only_b": 2, "neither": 0, "p_value": 1.0}
    assert found["kinds"]["all"]["both"] == 3
    assert found["other_logs"] == 1
    assert found["cpu_ratio"] == 0.5
    assert [(p["outcome"], q["outcome"]) for p, q in found["differ"]] == [
        ("exact", "wrong"),
        ("wrong", "tied"),
        ("wrong", "exact"),
    ]


def test_mcnemar_is_exact():
    a, b = many(PLANTED, "exact " * 6), many(PLANTED, "wrong " * 6)
    assert compare(by_key(a), by_key(b))["kinds"]["all"]["p_value"] == pytest.approx(2 / 2**6)


def test_two_dresses_side_by_side():
    a = many(PLANTED, "exact exact")
    b = many(PLANTED, "exact wrong", HALF, log="another")
    found = compare(by_key(a), by_key(b))
    assert (found["other_logs"], found["kinds"]["all"]["only_a"]) == (0, 1)


def test_share_has_the_exact_interval():
    # Clopper & Pearson: none of 200 leaves 1 - 0.025 ** (1 / 200)
    assert share(0, 200)["high"] == pytest.approx(1 - 0.025 ** (1 / 200))
    assert share(0, 0) is None


# --- the command line ---


def run(monkeypatch, *options: str) -> None:
    monkeypatch.setattr(sys, "argv", ["planted", *options])
    planted.main()


def test_run_summary_and_compare(monkeypatch, capsys, tmp_path, unasked, checkout):
    one, other = str(tmp_path / "one"), str(tmp_path / "other")
    some = ["--count", "planted=6", "--count", "nothing=2", "--seed", "1", "--root", str(checkout)]
    run(monkeypatch, "run", "--out", one, *some)
    run(monkeypatch, "run", "--out", one, *some, "--dress", HALF)
    run(monkeypatch, "run", "--out", other, *some, "--sample", "3")
    assert {c.dress for c in unasked} == {PLAIN, HALF}
    said = capsys.readouterr().out
    assert "plain: right, of one effect that doubles the floor (6 of 6; 54.1 to 100.0 %)" in said
    assert "half-rate: false alarms, of nothing missing (0 of 2; 0.0 to 84.2 %)" in said
    kept = json.loads((tmp_path / "one" / "summary.json").read_text())["dresses"]
    assert {d: own["right"]["of"] for d, own in kept.items()} == {PLAIN: 6, HALF: 6}
    run(monkeypatch, "compare", f"{one}/plain.jsonl", f"{other}/plain.jsonl")
    said = capsys.readouterr().out
    assert "all            3     0     0     0       1\n" in said
    assert "median CPU ratio, B over A: 1" in said


def test_a_version_that_changes_while_it_is_asked_adds_no_row(
    monkeypatch, capsys, tmp_path, unasked, checkout
):
    def row(case: Case, root) -> dict:
        (checkout / "capture_cli" / "more.py").write_text("two = 2\n")
        return answered(case, root)

    monkeypatch.setattr(rows_module, "row_of", row)
    with pytest.raises(SystemExit, match="2"):
        run(
            monkeypatch,
            "run",
            "--out",
            str(tmp_path / "out"),
            "--root",
            str(checkout),
            "--count",
            "nothing=2",
        )
    assert "the version that is asked is" in capsys.readouterr().err
    assert not (tmp_path / "out" / "plain.jsonl").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["run", "--count", "plantd=3"], "error: --count 'plantd=3' is not KIND=N"),
        (["run", "--root", "nowhere"], "holds no capture_cli"),
        (["summary"], "holds no row of a log"),
        (["compare"], "holds no row of a log"),
    ],
)
def test_nothing_to_do_is_said_and_nothing_written(monkeypatch, capsys, tmp_path, options, said):
    where = {
        "run": ["--out", str(tmp_path)],
        "summary": [str(tmp_path)],
        "compare": [str(tmp_path / "a")] * 2,
    }
    with pytest.raises(SystemExit, match="2"):
        run(monkeypatch, *options, *where[options[0]])
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_workers_end_with_who_started_them_and_so_do_their_children(number):
    """A process that lives on holds stdout open, and `run` waits for it."""
    code = f"""
import os, signal, subprocess, time
from benchmarks._planted.rows import workers
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
with workers(1) as pool:
    pool.submit(os.getpid).result()
    pool.submit(subprocess.run, ["sleep", "300"])
    time.sleep(0.5)
    os.kill(os.getpid(), {int(number)})
    time.sleep(300)
"""
    ended = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, timeout=60)
    assert ended.returncode != 0


# --- chains ---


def test_the_exponent_is_that_of_cpu_by_joints(monkeypatch, tmp_path):
    found = {"effects": [effect("coulomb-friction", "j1")]}
    monkeypatch.setattr(chain, "_asked", lambda joints: Answer(found, 1.0, 0.5 * joints**1.2))
    result = chain.Chain(logs=1, folder=tmp_path).run()
    assert result.figures[-1].value == pytest.approx(1.2)
    assert result.figures[-1].met
    assert result.details["24"]["found"] == ["coulomb-friction@j1"]


def test_the_middle_joint_of_a_chain_rubs_so_that_it_shows(tmp_path):
    task, log = chain.planted(3, tmp_path)
    made = Experiment(chain.chain(3, tmp_path), np.random.default_rng(3), chain.EPISODES)
    bare = made.outputs()
    apart = np.sqrt(((log.outputs - made.noise - bare) ** 2).mean(axis=0)) / chain.NOISE
    assert apart.argmax() == 1
    assert apart[1] > 3
    assert np.abs(log.check().outputs).max() < 1.0  # rad: it follows its commands
    assert len(task.space) == len(task.inputs) == len(task.outputs) == 3
