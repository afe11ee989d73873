"""The benchmarks' own arithmetic: targets, intervals of shares, work taken up again; and that each can be found."""

from __future__ import annotations

import json

import numpy as np
import pytest

import benchmarks.coverage as coverage
from benchmarks import EMPS, MACHINES, REGISTRY, _lines
from benchmarks._share import share
from benchmarks.base import Benchmark, Figure, Result, measure
from benchmarks.label_information import CELLS, KNOWN, REACH, Noise, read_labels, success
from capture_cli.model.tasks import load_task


def test_every_benchmark_is_found_and_says_what_it_measures():
    assert {"coverage", "engine", "startup", "sysid"} <= set(REGISTRY.names())
    assert all(b.summary for _, b in REGISTRY.items())


@pytest.mark.parametrize("folder", [*sorted(MACHINES.iterdir()), EMPS], ids=lambda f: f.name)
def test_every_machine_loads(folder):
    assert len(load_task(str(folder)).space) >= 1


@pytest.mark.parametrize(
    ("target", "value", "met"),
    [
        (None, 1.0, None),
        ((0.85, None), 0.85, True),
        ((0.85, None), 0.84, False),
        ((None, 0.3), 0.31, False),
        ((0.92, 0.98), 0.95, True),
        ((0.92, 0.98), 0.99, False),
    ],
)
def test_a_figure_knows_whether_it_met_its_target(target, value, met):
    assert Figure("share", value, target=target).met is met


@pytest.mark.parametrize("hits", [0, 1, 13, 39, 40])
def test_clopper_pearson_leaves_two_and_a_half_percent_on_either_side(hits):
    from scipy.stats import binom

    found = share(hits, 40)
    low, high = found["low"], found["high"]
    assert low <= hits / 40 <= high
    if hits > 0:
        assert binom.sf(hits - 1, 40, low) == pytest.approx(0.025)
    if hits < 40:
        assert binom.cdf(hits, 40, high) == pytest.approx(0.025)
    assert (low == 0) == (hits == 0)
    assert (high == 1) == (hits == 40)


def test_a_result_is_written_with_what_made_it(tmp_path):
    class Seven(Benchmark):
        summary = "seven"

        def run(self):
            return Result([Figure("seven", 7.0, "s", (None, 8.0))], {"steps": [3, 4]})

    _, path = measure("seven", Seven(logs=2, folder=tmp_path / "new"))
    document = json.loads(path.read_text())
    (figure,) = document["figures"]
    assert (figure["value"], figure["met"]) == (7.0, True)
    assert document["details"] == {"steps": [3, 4]}
    assert document["machine"]["cpus"] >= 1
    assert {"capture", "packages", "began", "python"} <= set(document["provenance"])


@pytest.fixture
def identified(monkeypatch) -> list:
    """Logs that were identified; every tenth interval misses the truth."""
    done = []

    def identify(case):
        done.append(case)
        truth = 0.1 * (len(done) % 10)
        parameter = {"truth": truth, "value": 0.5, "sd": 0.2, "ci95": [0.1, 0.9], "low": 0.0, "high": 1.0}
        verdict = "unexplained" if case.seed == 3 else "explained"
        return {
            "verdict": verdict,
            "normalized": {"fit": 1.0, "test": 1.1},
            "parameters": {"mass": parameter},
        }

    monkeypatch.setattr(coverage, "_identify", identify)
    monkeypatch.setattr(coverage, "WITHOUT_NOISE", 5)
    return done


def figures(result: Result) -> dict[str, float]:
    return {f.name: f.value for f in result.figures}


def test_coverage_counts(tmp_path, identified):
    found = figures(coverage.Coverage(logs=10, folder=tmp_path).run())
    assert len(identified) == 5 * 10 + 3 * 2
    noisy = [d for d in identified if d.noisy]
    missed = sum((n + 1) % 10 == 0 for n, case in enumerate(identified) if case.noisy)
    assert found["share of all 50 95 % intervals that hold the truth"] == pytest.approx(
        1 - missed / len(noisy)
    )
    assert found['share of 50 logs falsely called "unexplained"'] == pytest.approx(5 / 50)
    assert found["largest error over the range, 6 logs without noise"] <= 0.5


def test_coverage_is_taken_up_where_it_stopped(tmp_path, identified):
    coverage.Coverage(logs=4, folder=tmp_path).run()
    first = len(identified)
    path = tmp_path / "coverage" / "arm.jsonl"
    kept = path.read_text().splitlines()
    path.write_text("\n".join(kept[:-1]) + "\n" + kept[-1][: len(kept[-1]) // 2])  # killed while writing
    coverage.Coverage(logs=4, folder=tmp_path).run()
    assert len(identified) == first + 1
    coverage.Coverage(logs=4, folder=tmp_path).run()
    assert len(identified) == first + 1


def test_a_line_after_one_that_was_cut_off_is_read(tmp_path):
    path = tmp_path / "new" / "lines.jsonl"
    assert _lines.read(path) == []
    _lines.append(path, {"case": 1})
    path.write_text(path.read_text() + '{"case": 2, "fou')  # killed while writing
    _lines.append(path, {"case": 3})
    assert [line["case"] for line in _lines.read(path)] == [1, 3]


def test_lines_of_other_code_do_not_count(tmp_path, identified, monkeypatch):
    coverage.Coverage(logs=1, folder=tmp_path).run()
    first = len(identified)
    monkeypatch.setattr(coverage, "_code", lambda: "another")
    coverage.Coverage(logs=1, folder=tmp_path).run()
    assert len(identified) == 2 * first


def test_a_real_log_is_recorded_and_identified():
    found = coverage._identify(coverage._Case("slider", 0, True))
    assert set(found["parameters"]) == {"mass", "damping", "stiffness"}
    for p in found["parameters"].values():
        assert p["ci95"][0] < p["value"] < p["ci95"][1]
        assert abs(p["value"] - p["truth"]) < 6 * p["sd"]
    assert np.isfinite(found["normalized"]["test"])


@pytest.mark.parametrize("rounds", [2, 4])
def test_labels_that_are_random_tell_nothing(rounds):
    assert success(Noise.of_rates([[1.0] * rounds]), rounds) == pytest.approx((2 * REACH + 1) / CELLS)


def test_one_random_label_counted_is_one_of_as_many_hypotheses():
    counted, each = Noise.of_count(4, 1), Noise.of_rates(np.eye(4).tolist())
    assert success(counted, 4) == pytest.approx(success(each, 4))


def test_who_knows_more_about_the_noise_succeeds_more():
    at_best = {what: success(known(5), 5) for what, known in KNOWN.items()}
    none, which, how_many, phase, rate = at_best.values()
    assert none > which > how_many > rate and which > phase


def test_a_reader_of_labels_is_as_good_as_may_be_where_none_is_random():
    at_best = success(KNOWN["no label is random"](3), 3)
    assert read_labels(np.zeros((400, 3), dtype=bool)) == pytest.approx(at_best, abs=0.07)
    assert read_labels(np.ones((400, 3), dtype=bool)) < 0.15
