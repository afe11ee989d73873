"""capture eval-sim2sim: the same pairs for all, tables from arrays, runs that go on, options that cannot be."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from capture_cli.cli.app import app
from capture_cli.context.checkpoints.checkpoint_hash import checkpoint_hash
from capture_cli.context.checkpoints.identifier_checkpoint import load_identifier
from capture_cli.context.evaluation.evaluated_identifier import PAPER
from capture_cli.context.evaluation.evaluation_summary import ours_among, paired_comparison
from capture_cli.context.evaluation.sim2sim import Sim2Sim
from capture_cli.context.identifiers import round_identifier
from capture_cli.context.identifiers.compass import Compass
from capture_cli.context.policies.random import Random
from capture_cli.errors import CaptureError, OptionError, OutputError, StoreError, TaskError
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.air_hockey import AirHockey
from capture_cli.report import paper_numbers
from capture_cli.report.evaluation_tables import markdown, print_evaluation, tables
from capture_cli.stages.effect_option import parse_effects
from capture_cli.stages.eval_sim2sim import eval_sim2sim
from capture_cli.stages.evaluation import evaluation_run
from capture_cli.stages.evaluation.evaluation_run import evaluate
from capture_cli.stages.evaluation.evaluation_suite import SUITES, _members, _why_not, evaluate_suite
from capture_cli.stages.gen_histories import gen_histories
from capture_cli.stages.train_sysid import train_sysid
from capture_cli.store.evaluation import Evaluation
from capture_cli.store.output import sha256
from capture_cli.store.trained import TrainedIdentifier

SMALL = {"task": "scooping", "pairs": 6, "seeds": 2, "rounds": 4, "threads": 1}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("evaluation")


@pytest.fixture(scope="module")
def names(trained):
    """One identifier that knows nothing, and one that simulates besides."""
    return ["domain-randomization", f"capture-refined={trained}"]


@pytest.fixture(scope="module")
def evaluated(folder, names) -> Evaluation:
    return evaluate(out=folder / "e", identifiers=names, **SMALL)


@pytest.fixture(scope="module")
def trained(folder, learn):
    """A checkpoint that has learned next to nothing."""
    return checkpoint(folder, "posterior", "posterior")


def checkpoint(folder: Path, name: str, identifier: str, **of_histories) -> Path:
    """What `identifier` learns in three steps from 32 histories of scooping."""
    histories = folder / f"{name}.zarr"
    gen_histories(task="scooping", out=histories, pairs=32, threads=1, shard_pairs=32, **of_histories)
    small = {"width": 8, "layers": 1, "heads": 1, "steps": 3, "batch": 16}
    train_sysid(histories=histories, out=folder / name, identifier=identifier, **small)
    return folder / name


@pytest.fixture(autouse=True)
def one_is_drawn(monkeypatch, evaluated):
    """The figures of `evaluated`, of what it evaluates, and of no other."""
    monkeypatch.setattr("capture_cli.report.evaluation_figures.write_figures", lambda *_: None)
    monkeypatch.setattr("capture_cli.report.training.write_identifier_figure", lambda *_: None)


@pytest.fixture(autouse=True)
def compass_learns_little(monkeypatch):
    """How near it comes is asked in test_rounds.py."""
    monkeypatch.setitem(Compass.__init__.__kwdefaults__, "fit_steps", 30)


def test_the_arrays_are_what_the_document_sums_up(evaluated):
    arrays, document = evaluated.arrays, evaluated.document
    assert arrays["estimates"].shape == (2, 2, 6, 5, 1)
    np.testing.assert_array_equal(arrays["estimates"][:, :, :, 0], np.stack([arrays["source"]] * 2))
    difference = (
        np.abs(arrays["estimates"] - arrays["target"][None, :, :, None]).mean(axis=(1, 2))[..., 0] / 2
    )
    for k, entry in enumerate(document["identifiers"].values()):
        np.testing.assert_allclose(entry["parameter_difference"]["com"], difference[k], rtol=1e-5)
        np.testing.assert_allclose(entry["success"], arrays["success"][k].mean(axis=(0, 1)), rtol=1e-5)
    assert document["identifiers"]["domain-randomization"]["simulated_rollouts"] == [0, 1, 2, 3, 4]
    assert document["identifiers"]["capture-refined"]["simulated_rollouts"][-1] > 4
    assert document["identifiers"]["capture-refined"]["paired"] is None
    paired = document["identifiers"]["domain-randomization"]["paired"]
    assert [sum(c) for c in zip(*(paired[k] for k in ("nearer", "as_near", "further")), strict=True)] == [
        12
    ] * 5
    assert any(rows.title == "Pair by pair" for rows in tables(document))


def test_it_is_written_and_read(evaluated, folder):
    again = Evaluation.read(folder / "e")
    assert again.document == evaluated.document
    files = {p.name for p in (folder / "e").iterdir()}
    assert files >= {"tables.md", "success.png", "parameter_difference.png", "provenance.json"}
    assert not files & {"parts", "recipe.json"}


def test_a_trajectory_difference_is_that_of_the_estimate():
    task = load_task("scooping")
    draw = Sim2Sim(task, Random(task), 5, 3, threads=1)
    arrays = draw.run(round_identifier("domain-randomization"))
    uniform = draw._uniform()
    _, target = draw.ends()
    for number in range(4):
        actions = draw.policy.act(arrays["estimates"][:, number], uniform[:, number])
        from capture_cli.simulate.simulator import Simulator

        simulator = Simulator(task, threads=1)
        simulated, _ = simulator.trajectories(arrays["estimates"][:, number], actions)
        measured, _ = simulator.trajectories(target, actions)
        expected = np.linalg.norm(simulated - measured, axis=-1).sum(axis=-1)
        np.testing.assert_allclose(arrays["trajectory_difference"][:, number], expected, atol=1e-9)
        np.testing.assert_array_equal(arrays["success"][:, number], measured[:, -1, 0] == 0)


def test_pairs_do_not_depend_on_their_number():
    task = load_task("scooping")
    few, many = (Sim2Sim(task, Random(task), n, r, "label", threads=1) for n, r in ((3, 2), (5, 4)))
    one, two = (d.run(round_identifier("domain-randomization")) for d in (few, many))
    np.testing.assert_array_equal(few.ends(), np.array(many.ends())[:, :3])
    np.testing.assert_array_equal(one["estimates"][:, 0], two["estimates"][:3, 0])


def test_a_run_goes_on_where_it_ended(folder, evaluated, names, monkeypatch):
    kept = []
    real = Sim2Sim.run

    def once(self, *arguments):
        if kept:
            raise KeyboardInterrupt
        kept.append(self.number)
        return real(self, *arguments)

    monkeypatch.setattr(Sim2Sim, "run", once)
    with pytest.raises(KeyboardInterrupt, match="1 of 4 parts are kept"):
        evaluate(out=folder / "killed", identifiers=names, **SMALL)
    assert not (folder / "killed").exists()
    monkeypatch.setattr(Sim2Sim, "run", real)
    with pytest.raises(OptionError, match=r"differs: rounds was \d+, now \d"):
        evaluate(out=folder / "killed", identifiers=names, resume=True, **{**SMALL, "rounds": 5})
    done = evaluate(out=folder / "killed", identifiers=names, resume=True, **SMALL)
    assert done.document == evaluated.document
    for name, values in evaluated.arrays.items():
        np.testing.assert_array_equal(done.arrays[name], values)
    read = evaluate(out=folder / "killed", identifiers=names, resume=True, **SMALL)
    assert read.document == done.document


def test_a_run_that_ended_before_its_first_part_keeps_nothing(folder, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Sim2Sim, "run", stop)
        with pytest.raises(KeyboardInterrupt, match=r"^$"):  # the command line says that nothing was written
            evaluate(out=folder / "stopped", identifiers=["domain-randomization"], **SMALL)
    assert not list(folder.glob(".stopped*"))
    evaluate(out=folder / "stopped", identifiers=["domain-randomization"], **SMALL)


def test_checkpoints_are_known_by_what_matters_of_them_and_by_the_hash_of_all_their_files(folder, trained):
    options = {"identifiers": [str(trained)], "out": folder / "hashed", **SMALL, "pairs": 1, "rounds": 1}
    evaluate(**options)
    (trained / "Thumbs.db").touch()
    evaluate(**options, resume=True)
    path = folder / "hashed" / "evaluation.zarr" / "zarr.json"
    path.write_text(path.read_text().replace(checkpoint_hash(trained), sha256(trained)))
    evaluate(**options, resume=True)
    (trained / "Thumbs.db").unlink()
    with pytest.raises(OptionError, match=r"differs: identifiers\[0\]\.sha256 was"):
        evaluate(**options, resume=True)


def test_a_run_that_was_killed_as_it_began_goes_on(folder, monkeypatch):
    options = {"identifiers": ["domain-randomization"], **SMALL, "pairs": 1}

    def half(path, document):
        path.write_text('{"pairs": 1,')
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(evaluation_run, "write_json", half)
        evaluate(out=folder / "begun", **options)
    evaluate(out=folder / "begun", resume=True, **options)
    assert sorted(p.name for p in (folder / "begun").iterdir() if "recipe" in p.name) == []


def test_a_checkpoint_and_another_name_for_it(folder, trained):
    identifiers = ["domain-randomization", str(trained), f"capture-refined={trained}"]
    few = {**SMALL, "pairs": 3, "seeds": 1}
    e = evaluate(out=folder / "learned", identifiers=identifiers, noise="label", **few)
    assert list(e.document["identifiers"]) == ["domain-randomization", "posterior", "capture-refined"]
    plain, refined = (
        e.document["identifiers"][n]["simulated_rollouts"] for n in ("posterior", "capture-refined")
    )
    assert plain[-1] == 4 < refined[-1]
    assert e.document["identifiers"]["posterior"]["coverage"] is not None
    told = evaluate(out=folder / "told", identifiers=identifiers, noise="label", known_noise=True, **few)
    assert told.document["noise"] == "label (known)"
    same = (told.arrays["estimates"] == e.arrays["estimates"]).all(axis=(1, 2, 3, 4))
    assert same.tolist() == [True, True, False]


def test_pairs_are_compared_one_by_one():
    generator = np.random.default_rng(0)
    ours = 0.1 * generator.random((1, 2, 50, 3, 4))
    better, same, worse = ours / 2, ours + 1e-5, ours + 0.1 * generator.random(ours.shape)
    compared = paired_comparison(
        ["better", "same", "worse", "capture-refined"], np.concatenate([better, same, worse, ours])
    )
    assert compared["capture-refined"] is None
    assert compared["same"]["as_near"] == [100] * 3 and compared["same"]["p"] == [1.0] * 3
    assert min(compared["worse"]["nearer"]) > 90 and max(compared["worse"]["p"]) < 1e-6
    assert min(compared["better"]["further"]) > 90
    for label, sign in (("worse", 1), ("better", -1)):
        gained, se = (np.array(compared[label][name]) for name in ("gained", "gained_se"))
        assert (sign * gained > 3 * se).all()
    assert paired_comparison(["better"], better) == {"better": None}


def test_pairs_are_compared_with_ours_however_it_was_trained(folder, trained):
    other = checkpoint(folder / "others", "L5", "capture-refined", rounds=5)
    identifiers = ["domain-randomization", str(other)]
    document = evaluate(out=folder / "L5-alone", identifiers=identifiers, **SMALL).document
    label = "capture-refined (L=5)"
    assert document["identifiers"][label]["paired"] is None
    assert document["identifiers"]["domain-randomization"]["paired"]["p"]
    paired = next(rows for rows in tables(document) if rows.title == "Pair by pair")
    assert paired.header[0] == f"{label} against" and label in paired.note
    about = [{"label": name, "identifier": "capture-refined"} for name in (label, "capture-refined [c]")]
    assert ours_among(about) == label
    assert (
        ours_among([*about, {"label": "capture-refined", "identifier": "capture-refined"}])
        == "capture-refined"
    )
    assert ours_among([{"label": "compass", "identifier": "compass"}]) is None


def test_noise_that_cannot_be_told_is_refused(folder):
    with pytest.raises(OptionError, match="known-noise"):
        evaluate(out=folder / "told", identifiers=["domain-randomization"], known_noise=True, **SMALL)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["posterior"], "must be trained"),
        ([], "no --identifier"),
        (["nobody"], "unknown identifier"),
        (["cma-es", "cma-es"], ": cma-es is given twice"),
    ],
)
def test_identifiers_that_cannot_be(folder, given, message):
    with pytest.raises(CaptureError, match=message):
        evaluate(out=folder / "none", identifiers=given, **SMALL)
    assert not (folder / "none").exists()


def test_the_identifiers_that_a_cure_names_need_no_checkpoint(folder):
    with pytest.raises(OptionError) as caught:
        evaluate(out=folder / "none", identifiers=["nobody"], **SMALL)
    assert "compass" in caught.value.cure and "posterior" not in caught.value.cure


def test_a_name_that_cannot_use_a_checkpoint(folder, trained):
    with pytest.raises(OptionError, match="no use to 'tunenet'"):
        evaluate(out=folder / "none", identifiers=[f"tunenet={trained}"], **SMALL)
    with pytest.raises(OptionError, match=r"no identifier.json .*posterior"):
        evaluate(out=folder / "none", identifiers=[str(folder)], **SMALL)


@pytest.mark.parametrize("suite", [None, "paper"])
def test_a_checkpoint_is_not_replaced_by_its_evaluation(folder, trained, suite):
    task = {"task": "scooping", **SMALL} if suite is None else {"task": "scooping"}
    with pytest.raises(OutputError, match="which is read"):
        eval_sim2sim(suite=suite, identifiers=[str(trained)], out=trained, force=True, **task)
    assert (trained / "identifier.json").is_file()


def test_a_machine_without_actions_is_refused(folder):
    with pytest.raises(TaskError, match="no actions") as caught:
        evaluate(out=folder / "none", identifiers=["cma-es"], **{**SMALL, "task": "datasets/cart/task.toml"})
    assert "--histories" in caught.value.cure


CART = str(Path(__file__).resolve().parents[1] / "datasets" / "cart" / "task.toml")


@pytest.fixture(scope="module")
def of_windows(folder, learn) -> tuple[Path, Path]:
    """Histories of the cart over windows of multisines, and what was learned from them."""
    made, learned = folder / "cart.zarr", folder / "of-cart"
    gen_histories(task=CART, out=made, pairs=40, rounds=3, points=5, threads=1)
    small = {"width": 8, "layers": 1, "heads": 1, "steps": 3, "batch": 16}
    train_sysid(histories=made, out=learned, identifier="tunenet-all-rounds", **small)
    return made, learned


def test_ones_own_machine_takes_the_actions_of_its_histories(folder, of_windows):
    histories, learned = of_windows
    options = {"task": CART, "pairs": 4, "seeds": 1, "rounds": 3, "threads": 1, "histories": histories}
    found = evaluate(out=folder / "own", identifiers=["least-squares", str(learned)], **options)
    rows = found.document["identifiers"]
    assert list(rows) == ["least-squares", "tunenet-all-rounds (L=3)"]
    # without noise three windows tell mass, damping and stiffness
    assert rows["least-squares"]["parameter_difference"]["mean"][-1] < 1e-3
    assert found.attributes["policy"]["sha256"] is not None and rows["least-squares"]["success"] is None
    with pytest.raises(OptionError, match="actions of its own"):
        evaluate(out=folder / "no", identifiers=["cma-es"], **{**options, "task": "scooping"})
    with pytest.raises(OptionError, match="--histories with --suite"):
        eval_sim2sim(suite="paper", identifiers=[], out=folder / "no", histories=histories)


def test_histories_of_another_machine_are_refused(folder, of_windows, tmp_path):
    for name in ("task.toml", "model.xml"):
        (tmp_path / name).write_text(Path(CART).with_name(name).read_text())
    model = tmp_path / "model.xml"
    model.write_text(model.read_text().replace('damping="2"', 'damping="2" frictionloss="1"'))
    options = {"pairs": 2, "seeds": 1, "rounds": 1, "identifiers": ["cma-es"], "out": folder / "no"}
    with pytest.raises(OptionError, match="of another model than"):
        evaluate(task=str(tmp_path / "task.toml"), histories=of_windows[0], **options)


def test_the_command_prints_one_document(folder, trained):
    arguments = ["--task", "scooping", "--identifier", "domain-randomization", "--pairs", "2", "--seeds", "1"]
    arguments += ["--rounds", "1", "--threads", "1", "--out", str(folder / "c"), "--json"]
    done = CliRunner().invoke(app, ["eval-sim2sim", *arguments])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["format"] == "capture/evaluation"


def test_names_are_text_in_the_tables(evaluated):
    document = json.loads(json.dumps(evaluated.document))
    document["identifiers"] = {"<img src=x>|" + n: e for n, e in document["identifiers"].items()}
    page = markdown(document, title="<b>")
    assert "<img" not in page and "<b>" not in page and "&lt;img src=x&gt;&#124;" in page


def test_tables_set_the_papers_numbers_beside_ours(evaluated):
    document = json.loads(json.dumps(evaluated.document))
    document["task"], document["rounds"], document["table_rounds"] = "air-hockey", 10, [5, 10]
    for entry in document["identifiers"].values():
        entry["paired"] = None
        for key in (
            "trajectory_difference",
            "trajectory_difference_sd",
            "ratio",
            "simulated_rollouts",
            "success",
        ):
            entry[key] = [0.5] * 11
        entry["parameter_difference"] = {k: [0.1] * 11 for k in (*document["parameters"], "mean")}
        entry["coverage"] = None
    rows = tables(document)[0].cells
    assert rows[0][0] == "domain-randomization" and rows[1] == (
        "  in the paper",
        "0.34 ± 0.03",
        "0.31 ± 0.02",
        "1.0",
    )
    assert "Table II" in markdown(document)
    document["rounds"], document["table_rounds"] = 3, [3]
    assert tables(document)[0].cells[1] == ("  in the paper", "–", "–")
    about = {"identifier": "capture", "search": "randomized-binary", "window": 4, "history_rounds": 7}
    assert paper_numbers.trajectory_difference("air-hockey", "none", about)[10] == (0.16, 0.01)
    assert paper_numbers.trajectory_difference("air-hockey", "scale", about) is None
    assert paper_numbers.trajectory_difference("air-hockey", "none", {**about, "window": 2}) is None


def test_a_narrow_terminal_cuts_nothing_off(evaluated):
    from rich.console import Console

    console = Console(width=50, record=True, file=io.StringIO())
    print_evaluation(evaluated.document, console, Path("out"))
    text = console.export_text()
    assert "Success, continued" in text and "…" not in text
    for rows in tables(evaluated.document):
        assert all(cell in text for cells in rows.cells for cell in cells)
    assert max(map(len, text.splitlines())) <= 50


# --- the suite ---


def test_the_suite_runs_what_there_are_checkpoints_for(folder, trained):
    options = {"pairs": 2, "seeds": 1, "rounds": 2, "threads": 1, "task": "scooping"}
    done = evaluate_suite(suite="paper", identifiers=[str(folder)], out=folder / "suite", **options)
    assert list(done["cells"]) == ["scooping", "scooping-noise"]
    assert done["without"] == ["scooping-L", "scooping-k"]
    assert list(done["cells"]["scooping"]["identifiers"]) == ["domain-randomization", "compass", "posterior"]
    assert done["cells"]["scooping-noise"]["noise"] == "label"
    assert "scooping-noise" in (folder / "suite" / "tables.md").read_text()
    again = evaluate_suite(
        suite="paper", identifiers=[str(folder)], out=folder / "suite", resume=True, **options
    )
    assert again == json.loads(json.dumps(done))


def _checkpoint(identifier: str, **facts) -> tuple[Path, TrainedIdentifier]:
    facts = {**PAPER, **facts}
    trained = TrainedIdentifier(
        identifier=identifier,
        task="scooping",
        architecture={"window": facts["window"], "tokens": "step"},
        training={},
        histories={"search": facts["search"], "rounds": facts["history_rounds"]},
        result={},
    )
    return Path(f"{identifier}-{'-'.join(map(str, facts.values()))}"), trained


def test_ablations_vary_one_thing():
    found = [
        _checkpoint("capture"),
        _checkpoint("capture", history_rounds=5),
        _checkpoint("capture", window=6),
        _checkpoint("capture", history_rounds=5, window=6),
        _checkpoint("capture", search="binary"),
        _checkpoint("tunenet", window=1),
        _checkpoint("capture-refined", window=7),
        _checkpoint("capture-trajectory"),
        _checkpoint("capture-trajectory", window=2),
        _checkpoint("tunenet-all-rounds", window=1),
    ]
    members = {c.name: _members(c, ["compass"], found) for c in SUITES["paper"] if c.task == "scooping"}
    path = {k: str(found[k][0]) for k in range(len(found))}
    assert members["scooping-L"] == [path[1], path[0]]
    assert members["scooping-k"] == [path[0], path[2], path[8], path[7]]
    posterior = f"posterior={path[6]}"
    ours = [path[7], posterior, path[6]]
    assert members["scooping"] == ["compass", path[5], path[9], path[4], path[0], *ours]


def test_a_suite_names_the_checkpoints_that_it_does_not_use(folder, trained, capsys):
    L5 = checkpoint(folder / "spare", "L5", "capture", rounds=5)
    options = {"suite": "paper", "pairs": 2, "seeds": 1, "rounds": 1, "threads": 1, "task": "scooping"}
    with pytest.raises(OptionError, match=r"L5 \(L 5, in the paper 7; an ablation takes") as caught:
        evaluate_suite(identifiers=[str(L5)], out=folder / "none", **options)
    assert "no checkpoint for scooping" in caught.value.message
    given = [str(trained), str(L5)]
    done = evaluate_suite(identifiers=given, out=folder / "some", **options, cells=["scooping"], quiet=False)
    assert [text.split(" (")[0] for text in done["not_used"]] == [str(L5)]
    assert f"not used: {L5} (L 5" in capsys.readouterr().err
    other = replace(_checkpoint("capture")[1], task="slider")
    assert _why_not(other, SUITES["paper"]) == "of the task 'slider'"


def test_an_ablation_spells_out_what_it_varies(folder, trained):
    """Two checkpoints that differ in L alone: the one that is as in the paper says so too."""
    for rounds in (5, 7):
        checkpoint(folder / "ablation", f"L{rounds}", "capture", rounds=rounds)
    options = {"pairs": 2, "seeds": 1, "rounds": 2, "threads": 1, "task": "scooping"}
    given = [str(folder / "ablation")]
    done = evaluate_suite(suite="paper", identifiers=given, out=folder / "ablated", **options)
    assert list(done["cells"]["scooping-L"]["identifiers"]) == ["capture (L=5)", "capture (L=7)"]
    assert "capture" in done["cells"]["scooping"]["identifiers"]
    provenance = json.loads((folder / "ablated" / "scooping-L" / "provenance.json").read_text())
    assert provenance["options"]["out"] == str(folder / "ablated" / "scooping-L")
    with pytest.raises(OptionError, match=r"differs: rounds was \d+, now \d"):
        evaluate_suite(
            suite="paper", identifiers=given, out=folder / "ablated", resume=True, **{**options, "rounds": 3}
        )
    with pytest.raises(OptionError, match="asked for are scooping, scooping-noise"):
        evaluate_suite(
            suite="paper", identifiers=[str(trained)], out=folder / "ablated", resume=True, **options
        )


def test_a_suite_says_first_how_long_it_will_take(folder, trained, capsys):
    options = {"pairs": 9, "seeds": 2, "rounds": 1, "threads": 1, "task": "scooping"}
    evaluate_suite(
        suite="paper", identifiers=[str(trained)], out=folder / "announced", quiet=False, **options
    )
    said = capsys.readouterr().err
    assert said.index("in all about") < said.index("[1/2] scooping")
    # in each of two cells 18 pairs of one round: measured once, simulated once, by COMPASS ten times
    assert "about 270 rollouts" in said and "in all about 540 rollouts" in said
    assert "for want of checkpoints: scooping-L, scooping-k" in said


def test_cells_of_a_suite_are_run_alone(folder, trained):
    options = {
        "suite": "paper",
        "identifiers": [str(trained)],
        "pairs": 2,
        "seeds": 1,
        "rounds": 1,
        "threads": 1,
    }
    done = eval_sim2sim(out=folder / "cell", cells=["scooping-noise"], **options)
    assert list(done["cells"]) == ["scooping-noise"] and done["without"] == []
    with pytest.raises(OptionError, match="--cell 'scooping-nois'") as error:
        eval_sim2sim(out=folder / "no-cell", cells=["scooping-nois"], **options)
    assert "scooping-noise" in error.value.cure
    with pytest.raises(OptionError, match="without --suite"):
        eval_sim2sim(
            out=folder / "no-cell", cells=["scooping"], **{**options, "suite": None, "task": "scooping"}
        )


@pytest.mark.usefixtures("learn")
def test_a_suite_with_nothing_to_run_is_refused(folder):
    with pytest.raises(OptionError, match="no checkpoint for air-hockey"):
        evaluate_suite(suite="paper", identifiers=[], out=folder / "nothing", task="air-hockey")
    with pytest.raises(OptionError, match="no task 'air-hokey'") as caught:
        evaluate_suite(suite="paper", identifiers=[], out=folder / "nothing", task="air-hokey")
    assert "'air-hockey'" in caught.value.cure


@pytest.mark.usefixtures("learn")
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        ("{}", "not of the format"),
        (
            '{"format": "capture/identifier", "version": 1, "task": "scooping"}',
            "architecture, training, histories",
        ),
    ],
)
def test_a_suite_names_the_checkpoint_that_is_damaged(tmp_path, text, message):
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "identifier.json").write_text(text)
    with pytest.raises(StoreError, match=message):
        evaluate_suite(suite="paper", identifiers=[str(tmp_path)], out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


# --- machines that have what the model lacks ---


def test_a_machine_has_what_nobody_is_told():
    """Simulated trajectories are of the declared model or what the identifier knows, measured ones of the machine."""
    task = AirHockey()
    lag = parse_effects(["control-lag@mallet_vx=0.1"], task.model)
    plain = Sim2Sim(task, Random(task), 4, 3, threads=1)
    lagging = replace(plain, effects=lag)
    make = round_identifier("domain-randomization")
    unknown, known = lagging.run(make), lagging.run(make, known=lag.at_middle)
    assert np.array_equal(unknown["estimates"], known["estimates"])
    # both sides have the lag: what is left is of the parameters, as where neither has it
    assert known["trajectory_difference"].mean() < 0.8 * unknown["trajectory_difference"].mean()
    zero = replace(plain, effects=parse_effects(["control-lag@mallet_vx=0"], task.model)).run(make)
    for name, values in plain.run(make).items():
        assert np.array_equal(values, zero[name], equal_nan=True), name


def test_the_evaluation_says_what_the_machines_have(tmp_path):
    options = {
        "task": "scooping",
        "identifiers": ["domain-randomization"],
        "pairs": 3,
        "seeds": 1,
        "rounds": 2,
    }
    effect = "control-bias@spatula_x=0:0.01"
    found = evaluate(**options, effects=[effect], out=tmp_path / "e", threads=1)
    [row] = found.document["effects"]
    assert row["parameters"]["offset"]["drawn"] == [0, 0.01] and found.attributes["effects"] == [row]
    assert "machines with control-bias@spatula_x" in (tmp_path / "e" / "tables.md").read_text()
    assert json.loads((tmp_path / "e" / "provenance.json").read_text())["options"]["effects"] == [effect]
    with pytest.raises(OptionError, match=r"differs: effects was "):
        evaluate(**options, out=tmp_path / "e", threads=1, resume=True)
    with pytest.raises(OptionError, match="--effect with --suite"):
        eval_sim2sim(suite="paper", effects=[effect], identifiers=[], out=tmp_path / "s")


def test_an_evaluation_of_the_version_before_had_no_effects(tmp_path):
    options = {
        "task": "scooping",
        "identifiers": ["domain-randomization"],
        "pairs": 2,
        "seeds": 1,
        "rounds": 1,
    }
    options |= {"out": tmp_path / "e", "threads": 1}
    evaluate(**options)
    for name in ("evaluation.json", "evaluation.zarr/zarr.json"):
        path = tmp_path / "e" / name
        document = json.loads(path.read_text())
        inner = document.get("attributes", document)
        assert (inner.pop("effects"), inner.pop("world"), inner.pop("robot")) == ([], "plant", None)
        assert inner["version"] == 4
        inner["version"] = 1
        path.write_text(json.dumps(document))
    assert evaluate(**options, resume=True).document["effects"] == []


def test_an_evaluation_of_the_version_before_had_one_name_for_two_networks(folder, learn):
    """`capture` was what is `capture-trajectory` now, and what has the paper's tokens."""
    made = checkpoint(folder / "tokens", "c", "capture-trajectory")
    document = json.loads((made / "identifier.json").read_text())
    (made / "identifier.json").write_text(json.dumps({**document, "identifier": "capture", "version": 2}))
    assert load_identifier(made).name == "capture-trajectory"
    (made / "identifier.json").write_text(json.dumps({**document, "identifier": "capture"}))
    with pytest.raises(StoreError, match="'capture' has one token a step"):
        load_identifier(made)
    (made / "identifier.json").write_text(json.dumps(document))
    out = folder / "tokens" / "e"
    options = {"task": "scooping", "identifiers": [str(made)], "pairs": 2, "seeds": 1, "rounds": 1}
    evaluate(out=out, **options)
    for name in ("evaluation.json", "evaluation.zarr/zarr.json"):
        text = (out / name).read_text()
        assert '"version": 4' in text
        text = text.replace('"version": 4', '"version": 2').replace("capture-trajectory", "capture")
        (out / name).write_text(text)
    assert list(evaluate(out=out, resume=True, **options).document["identifiers"]) == ["capture-trajectory"]


def test_the_papers_network_is_evaluated_under_its_own_name(folder, learn):
    both = folder / "both"
    for name in ("capture", "capture-trajectory", "tunenet-all-rounds"):
        checkpoint(both, name, name)
    options = {
        "suite": "paper",
        "pairs": 2,
        "seeds": 1,
        "rounds": 1,
        "cells": ["scooping"],
        "out": both / "s",
    }
    rows = eval_sim2sim(identifiers=[str(both)], **options)["cells"]["scooping"]["identifiers"]
    assert [name for name in rows if name not in ("domain-randomization", "compass")] == [
        "tunenet-all-rounds",
        "capture",
        "capture-trajectory",
    ]
    assert (rows["capture"]["tokens"], rows["capture-trajectory"]["tokens"]) == ("step", "trajectory")
    assert paper_numbers.trajectory_difference("air-hockey", "none", rows["capture"]) is not None
    assert paper_numbers.trajectory_difference("air-hockey", "none", rows["capture-trajectory"]) is None


@pytest.mark.usefixtures("learn")
def test_steps_of_compass_are_an_option(folder):
    options = {"task": "scooping", "pairs": 2, "seeds": 1, "rounds": 2, "fit_steps": 3}
    found = evaluate(out=folder / "steps", identifiers=["domain-randomization", "compass"], **options)
    assert list(found.document["identifiers"]) == ["domain-randomization", "compass (fit_steps=3)"]
    with pytest.raises(OptionError, match="--fit-steps without an identifier") as caught:
        evaluate(out=folder / "no-steps", identifiers=["domain-randomization"], **options)
    assert "compass" in caught.value.cure


def test_rows_of_other_code_are_not_gone_on_with(folder, monkeypatch):
    """They were, and four evaluations that are shipped had rows of older code among the others."""
    options = {
        "task": "scooping",
        "identifiers": ["domain-randomization"],
        "pairs": 2,
        "seeds": 2,
        "rounds": 1,
    }
    options |= {"out": folder / "of-code", "threads": 1}
    keep, count = evaluation_run._keep, iter(range(9))

    def killed(*arguments):
        if next(count) == 1:
            raise KeyboardInterrupt
        keep(*arguments)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(evaluation_run, "_keep", killed)
        evaluate(**options)
    with (
        monkeypatch.context() as patch,
        pytest.raises(OptionError, match=r"1 of 2 parts in .* another version"),
    ):
        patch.setattr(evaluation_run, "code_hash", lambda: "another")
        evaluate(**options, resume=True)
    assert evaluate(**options, resume=True).document["seeds"] == 2
