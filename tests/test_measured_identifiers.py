"""The page of evaluations: what its tables make of the JSON, and what they leave out."""

from __future__ import annotations

import json

import numpy as np
import pytest

from capture_cli.store.evaluation import Evaluation
from docs import measured_identifiers
from docs.measured_identifiers import Measured


def entry(errors: list[float], rollouts: list[float], paired=None) -> dict:
    return {
        "identifier": "x",
        "pairs_trained": 90,
        "parameter_difference": {"mean": errors},
        "trajectory_difference": errors,
        "ratio": None,
        "success": None,
        "coverage": None,
        "simulated_rollouts": rollouts,
        "paired": paired,
    }


@pytest.fixture
def measured() -> Measured:
    p = {"nearer": [0, 5, 9], "as_near": [0, 1, 1], "further": [0, 4, 0], "p": [1.0, 0.754, 0.0039]}
    rows = {
        "cma-es": entry([0.3, 0.2, 0.123], [0, 147, 440], p),
        "compass": entry([0.3, 0.2, 0.1], [0, 10, 20]),
    }
    document = {"task": "t", "pairs": 10, "seeds": 1, "rounds": 2, "noise": "none", "identifiers": rows}
    return Measured("folder", document, {"code": "0123456789abcdef"})


def test_a_table_says_how_many_pairs_it_is_of_and_whose_code_made_it(measured):
    assert "10 pairs, 2 rounds, trained on 90 histories; code 01234567." in measured.about()
    assert "the code was not noted" in Measured("folder", measured.document, {}).about()


def test_errors_stand_beside_what_was_simulated_for_them_where_several_simulate(measured):
    header, _, row, other = measured_identifiers.differences(measured).splitlines()
    assert header == "| parameter difference (rollouts so far) | 1 | 2 |"
    assert row == "| cma-es | 0.2 (147) | 0.12 (440) |" and other == "| compass | 0.2 (10) | 0.1 (20) |"
    alone = {**measured.document, "identifiers": {"cma-es": measured.rows["cma-es"]}}
    assert "| cover at 2 | rollouts |" in measured_identifiers.differences(Measured("f", alone, {}))


def test_trainings_of_all_that_is_compared_are_one_table(monkeypatch, measured):
    def of(training: int, error: float, rollouts: float) -> Measured:
        row = {**entry([0.3, error, error], [0, 1, rollouts]), "coverage": [0.9, error]}
        return Measured(f"equal/{training}", {**measured.document, "identifiers": {"x": row}}, {"code": "0"})

    alone = Measured("paper", of(1, 0.5, 2).document, {"code": "0"})
    monkeypatch.setattr(
        measured_identifiers, "_measured", lambda task: [of(1, 0.125, 2), of(2, 0.135, 4), alone]
    )
    text = measured_identifiers._sections("t", measured_identifiers.differences, "success")
    together, row, _, other = (text.splitlines()[n] for n in (0, 4, 5, -1))
    assert together.startswith("`equal`: 10 pairs") and together.endswith("2 trainings, ± their deviation.")
    assert row == "| x | 0.13 ± 0.007 | 0.13 | 3 | 0.13 |"
    assert "`paper`: 10 pairs" in text and other == "| x | 0.5 | 0.50 | 2 | 0.5 |"


def test_of_several_trainings_successes_are_means_and_pairs_are_of_the_least_favourable(measured):
    def of(success: float, nearer: int, p: float) -> Measured:
        paired = {"nearer": [0, nearer], "as_near": [0, 1], "further": [0, 9 - nearer], "p": [1.0, p]}
        rows = {
            "y": {**entry([0.3, 0.2], [0, 1], paired), "success": [0.0, success]},
            "z": {**entry([0.3, 0.2], [0, 1], {**paired, "p": [1.0, 0.0]}), "success": [0.0, 1.0]},
        }
        rows["domain-randomization"] = {**entry([0.3, 0.3], [0, 1]), "success": [0.0, 0.0]}
        return Measured("equal/1", {**measured.document, "rounds": 1, "identifiers": rows}, {})

    trainings = [of(0.5, 9, 1e-5), of(0.6, 5, 0.75)]
    *_, y, z = measured_identifiers.successes(*trainings).splitlines()
    assert y == "| y | 0.55 ± 0.07 |" and z == "| z | 1.00 ± 0 |"
    assert measured_identifiers.successes(trainings[0]).splitlines()[2] == "| y | 0.50 |"
    said = measured_identifiers.pairs(*trainings)
    assert said.startswith("At 1, in the training least in its favour, `capture-refined` is nearer")
    assert said.endswith("further than y 5/1/4 (p 0.75).")
    assert measured_identifiers.pairs(trainings[0]) == ""


def test_trainings_of_an_ablation_are_one_row_with_their_spread(measured):
    def of(training: int, cell: str, values: dict[str, float]) -> Measured:
        rows = {
            f"capture ({v})": {**entry([*[0.3] * 10, x], [1] * 11), "success": [0.5] * 11}
            for v, x in values.items()
        }
        document = {**measured.document, "rounds": 10, "identifiers": rows}
        return Measured(f"suite/{training}/{cell}", document, {})

    cells = [of(1, "L", {"L=5": 0.125, "L=7": 0.1}), of(1, "k", {"k=2": 0.2})]
    cells += [of(2, "L", {"L=5": 0.135, "L=7": 0.1}), of(2, "k", {"k=2": 0.4})]
    about, _, header, _, *rows = measured_identifiers.ablations(cells, "success").splitlines()
    assert about.startswith("`suite`: 10 pairs") and "2 trainings" in about
    assert header == "|  | parameters at 10 | success at 10 |"
    assert rows == [
        "| L=5 | 0.13 ± 0.007 | 0.5 ± 0 |",
        "| L=7 | 0.1 ± 0 | 0.5 ± 0 |",
        "| k=2 | 0.3 ± 0.1 | 0.5 ± 0 |",
    ]
    alone = measured_identifiers.ablations(cells[:2], "trajectory_difference").splitlines()
    assert alone[2] == "|  | parameters at 10 | trajectory at 10 |" and alone[-1] == "| k=2 | 0.2 | 0.2 |"


def test_probabilities_are_those_of_the_sign_test(measured):
    assert measured_identifiers.pairs(measured).endswith("further than cma-es 5/1/4 (p 0.75).")
    sure = {**measured.rows["cma-es"]["paired"], "p": [1.0, 1e-4, 1e-5]}
    rows = {**measured.rows, "cma-es": entry([0.3, 0.2, 0.123], [0, 147, 440], sure)}
    assert measured_identifiers.pairs(Measured("f", {**measured.document, "identifiers": rows}, {})) == ""


def test_rows_of_other_code_are_left_out(tmp_path, monkeypatch):
    """They were told in provenance.json, by the names that they had then."""
    monkeypatch.setattr(measured_identifiers, "RUNS", tmp_path)
    (tmp_path / "e").mkdir()
    row = {
        "identifier": "capture",
        "tokens": "trajectory",
        "parameter_difference": {"mean": [0.1]},
        "trajectory_difference": [0.1],
        "success": None,
    }
    about = {k: 1 for k in ("pairs", "seeds", "rounds")} | {"task": "t", "policy": "p", "noise": "none"}
    rows = {"capture": row, "capture (binary)": row}
    document = {"format": "capture/evaluation", "version": 2, "effects": [], "identifiers": rows, **about}
    (tmp_path / "e" / "evaluation.json").write_text(json.dumps(document))
    made = {"taken_over": {"identifiers": ["capture"]}}
    (tmp_path / "e" / "provenance.json").write_text(json.dumps(made))
    assert list(Measured.read("e").rows) == ["capture-trajectory (binary)"]
    assert measured_identifiers._measured("t") == []
    (tmp_path / "e" / "provenance.json").write_text(json.dumps({"code": "0", **made}))
    assert [m.folder for m in measured_identifiers._measured("t")] == ["e"]


def test_robots_stand_side_by_side_with_the_paper(monkeypatch):
    def of(robot: str, shares: list[float]) -> Measured:
        rows = {
            "tunenet": {**entry([0.4, 0.2], [0, 1]), "identifier": "tunenet", "success": shares},
            "posterior": {**entry([0.4, 0.1], [0, 1]), "identifier": "posterior", "success": shares},
        }
        document = {"task": "scooping", "pairs": 4, "rounds": 1, "robot": robot, "identifiers": rows}
        return Measured(robot.lower(), document, {"code": "0123456789abcdef"})

    found = [of("Panda", [0.0, 0.5]), of("UR5e", [0.25, 1.0])]
    header, _, *rows = measured_identifiers.in_world_successes(found).splitlines()
    assert header == "| success at 1, 5, 9, % | Panda | UR5e | in the paper |"
    assert rows[0] == "| tunenet | 50 | 100 | 30, 60, 30 |"
    assert rows[1] == "| posterior | 50 | 100 |  |" and rows[2].startswith("| capture |  |  | 20, 80")
    gains = measured_identifiers.in_world_gains(found).splitlines()
    assert gains[2] == "| tunenet | 0.5; 0, 50 | 0.5; 25, 100 |" and len(gains) == 4
    monkeypatch.setattr(
        measured_identifiers, "_measured", lambda task, in_world: found if task == "scooping" else []
    )
    about, _ = measured_identifiers.worlds().split("\n\n")
    assert about == "`runs/evaluation/scooping-world-*`: 4 pairs, 1 rounds; code 01234567."


def test_what_intervals_claim_stands_beside_what_estimates_are_off_by(monkeypatch):
    """Of two parameters over ranges of 2 and 10: the second is off by a tenth in all tables."""
    estimates, target = np.zeros((1, 1, 3, 2, 2)), np.zeros((1, 3, 2))
    estimates[0, 0, :, 1] = [[-0.04, 0.9], [0.0, 1.0], [0.04, 1.1]]
    arrays = {"estimates": estimates, "target": target, "sd": np.full_like(estimates, 0.01)}
    attributes = {"parameters": [{"low": 0.0, "high": 2.0}, {"low": -5.0, "high": 5.0}]}
    found = Evaluation({"rounds": 1}, arrays, attributes)
    monkeypatch.setattr(Evaluation, "read", lambda folder: found)
    said = measured_identifiers._loop_errors()
    assert "claim standard deviations of 0.1 to 0.5 % of the ranges" in said
    assert "by 1 to 2 % among tables" in said and said.endswith("over all tables is 0 to 10 %.")


def test_of_one_kind_policy_and_identifier_win_what_their_evaluation_says():
    halves = json.loads(measured_identifiers.HALVES.read_text())["success"]
    for kind, folder in zip(("declared", "mended"), measured_identifiers.LOOP.values(), strict=True):
        document = measured_identifiers.Evaluation.read_document(folder / "evaluation")
        [entry] = document["identifiers"].values()
        assert sum(halves[kind][kind]) == round(document["pairs"] * entry["success"][-1])
