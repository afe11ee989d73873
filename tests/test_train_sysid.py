"""Training: the same bytes for the same seed, also when it was interrupted; clear refusals; and that it learns."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra learn")

import torch
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import load_file, save_file
from toy_rounds import SIGNATURE, draw_actions, histories, simulate, trajectories, write
from typer.testing import CliRunner

from capture_cli.cli.app import app
from capture_cli.context.checkpoints.identifier_checkpoint import (
    load_identifier,
    read_document,
    save_identifier,
)
from capture_cli.context.checkpoints.training_state import check_recipe
from capture_cli.context.identifiers import REGISTRY, _batches
from capture_cli.context.identifiers._batches import Batches, Place, windows
from capture_cli.context.identifiers._learned import LearnedIdentifier
from capture_cli.context.identifiers._training import Device, Settings, Trainer, TrainingHistories
from capture_cli.context.identifiers._transformer import Architecture
from capture_cli.context.identifiers.base import Signature, run_rounds
from capture_cli.errors import FitError, OptionError, OutputError, StoreError
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.report import training
from capture_cli.stages import train_sysid as stage
from capture_cli.stages.train_sysid import train_sysid
from capture_cli.store.histories import Histories
from capture_cli.store.output import NEW, unfinished

# those that are what was trained, and no more
LEARNED = [n for n, c in REGISTRY.items() if issubclass(c, LearnedIdentifier) and not c.simulates]
TINY = {"width": 16, "layers": 1, "heads": 2, "steps": 12, "batch": 16, "warmup": 2}
FILES = ("identifier.json", "identifier.safetensors", "metrics.jsonl")
WRITE_FIGURE = training.write_identifier_figure


@pytest.fixture(autouse=True)
def those_of_trained_are_drawn(monkeypatch):
    """The figures of `trained`, and of no other."""
    monkeypatch.setattr(training, "write_identifier_figure", lambda *_: None)


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Path:
    return write(histories(1920, rounds=5), tmp_path_factory.mktemp("toy") / "h.zarr")


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> Path:
    return write(histories(64, rounds=5), tmp_path_factory.mktemp("toy") / "small.zarr")


@pytest.fixture(scope="module")
def trained(store, tmp_path_factory):
    """A checkpoint directory of the identifier called so."""
    folder, made = tmp_path_factory.mktemp("trained"), {}

    def make(name: str) -> Path:
        if name not in made:
            made[name] = folder / name
            with mock.patch.object(training, "write_identifier_figure", WRITE_FIGURE):
                train_sysid(
                    histories=store,
                    out=made[name],
                    identifier=name,
                    **{
                        **TINY,
                        "width": 32,
                        "steps": 100,
                        "batch": 64,
                        "learning_rate": 5e-3,
                        "warmup": 10,
                        "patience": 50,
                    },
                )
        return made[name]

    return make


def walk(checkpoint: Path, rounds: int = 6, pairs: int = 100):
    """The error in the unit cube (pair, round, parameter), over new targets from random initial states, and the
    walk.
    """
    found = load_identifier(checkpoint, SIGNATURE)
    generator = np.random.default_rng(7)
    target, start = (SIGNATURE.space.from_unit(generator.random((pairs, 2))) for _ in range(2))
    actions = [draw_actions(generator, pairs) for _ in range(rounds)]
    done = run_rounds(
        found.kind(SIGNATURE, start, model=found.model),
        rounds,
        act=lambda i, _: actions[i],
        simulate=simulate,
        measure=lambda i, a: trajectories(target, a),
    )
    return np.abs(done.estimates - target[:, None]) / SIGNATURE.space.span, done


# --- that it learns ---


@pytest.mark.parametrize("name", LEARNED)
def test_it_finds_the_parameters_of_new_targets(trained, name):
    error, done = walk(trained(name))
    at_random, in_the_middle = 1 / 3, 1 / 4  # mean errors of those who do not look
    assert error[:, -1].mean() < 0.08 < in_the_middle < at_random
    assert (done.estimates >= SIGNATURE.space.low).all() and (done.estimates <= SIGNATURE.space.high).all()
    assert (done.simulated_rollouts[:, -1] == 6).all()


def test_the_search_is_imitated_and_stays_at_the_target(trained):
    error, _ = walk(trained("capture-trajectory"), rounds=12)
    by_round = error.mean(axis=(0, 2))
    assert by_round[0] > by_round[2] > by_round[5]
    assert by_round[-1] < 1.5 * by_round[5] + 0.01


@pytest.mark.parametrize("name", ["posterior", "expert-distillation"])
def test_its_uncertainty_covers_the_target(trained, name):
    """In the first round, whose pairs are like those it was calibrated on."""
    error, done = walk(trained(name), rounds=1, pairs=400)
    sd = done.sd / SIGNATURE.space.span
    assert 0.85 < (error <= 1.96 * sd).mean() < 0.995
    wide = sd > np.median(sd)
    assert error[wide].mean() > error[~wide].mean()


def test_what_is_read_is_what_was_written(trained, tmp_path):
    """However the arrays lay in memory."""
    folder = trained("posterior")
    model = load_identifier(folder).model
    model.network = {name: np.asfortranarray(array) for name, array in model.network.items()}
    save_identifier(model, read_document(folder), tmp_path)
    _, written = model.state()
    _, read = load_identifier(tmp_path).model.state()
    assert written.keys() == read.keys()
    for name, array in written.items():
        assert np.array_equal(array, read[name]), name


def test_what_was_measured_decides(trained):
    found = load_identifier(trained("posterior"))
    rounds = histories(50, rounds=3, seed=5)
    other = rounds.pairs(np.roll(np.arange(50), 1)).measured
    as_measured = found.model.predict(rounds).mean
    exchanged = found.model.predict(
        type(rounds)(rounds.parameters, rounds.actions, rounds.simulated, other)
    ).mean
    assert np.abs(as_measured - exchanged).max() > 0.2 * SIGNATURE.space.span.min()


def test_a_log_from_outside_is_noticed(trained):
    """An effect that no training history had: a puck that curves."""
    family = load_identifier(trained("capture")).model.family
    usual = histories(200, rounds=5, seed=11)
    assert (family.share_beyond(usual) < 0.01).mean() < 0.05
    for count in range(1, 6):  # shares of what is like the histories held out are uniform
        assert abs(family.share_beyond(usual.first(count)).mean() - 0.5) < 0.1
    curve = np.zeros(SIGNATURE.trajectory_shape)
    curve[:, 1] = 0.03 * SIGNATURE.point_times**2
    curved = type(usual)(usual.parameters, usual.actions, usual.simulated, usual.measured + curve)
    assert (family.share_beyond(curved) < 0.01).mean() > 0.9


def test_a_run_interrupted_before_it_evaluated_keeps_nothing(small, tmp_path, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(stage, "save_state", stop)
    with pytest.raises(KeyboardInterrupt, match=r"^$"):  # the command line says that nothing was written
        train_sysid(histories=small, out=tmp_path / "a", **TINY)
    assert not list(tmp_path.iterdir())


# --- the same bytes ---


def test_the_same_seed_gives_the_same_bytes(small, tmp_path):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        train_sysid(histories=small, out=tmp_path / name, dropout=0.1, seed=seed, **TINY)
    for file in FILES:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    assert (tmp_path / "a" / FILES[1]).read_bytes() != (tmp_path / "c" / FILES[1]).read_bytes()


def test_an_interrupted_run_goes_on_to_the_same_bytes(small, tmp_path, monkeypatch):
    whole, resumed = tmp_path / "whole", tmp_path / "resumed"
    options = {"histories": small, "dropout": 0.1, "identifier": "posterior", **TINY}
    train_sysid(out=whole, **options)
    save, saved = stage.save_state, []

    def save_then_stop(*arguments):
        save(*arguments)
        saved.append(arguments)
        if len(saved) == 5:
            raise KeyboardInterrupt

    monkeypatch.setattr(stage, "save_state", save_then_stop)
    with pytest.raises(KeyboardInterrupt, match="--resume"):
        train_sysid(out=resumed, **options)
    assert not resumed.exists() and unfinished(resumed).is_dir()
    monkeypatch.setattr(stage, "save_state", save)
    with pytest.raises(OutputError, match="unfinished"):
        train_sysid(out=resumed, **options)
    with pytest.raises(OptionError, match=r"training.seed was 0, now 1"):
        train_sysid(out=resumed, resume=True, seed=1, **options)
    with pytest.raises(OptionError, match=r"device.low_precision was False, now True"):
        train_sysid(out=resumed, resume=True, precision="bfloat16", **options)
    train_sysid(out=resumed, resume=True, **options)
    for file in FILES:
        assert (whole / file).read_bytes() == (resumed / file).read_bytes()
    assert (
        not any((resumed / name).exists() for name in (stage.STATE, f"{stage.STATE}{NEW}"))
        and not unfinished(resumed).exists()
    )
    # one that is complete is read
    document = json.loads((resumed / "identifier.json").read_text())
    assert train_sysid(out=resumed, resume=True, **options) == document
    with pytest.raises(OptionError, match=r"training.seed was 0, now 1"):
        train_sysid(out=resumed, resume=True, seed=1, **options)
    with pytest.raises(OutputError, match="exists already"):
        train_sysid(out=resumed, **options)


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 40), st.integers(1, 50), st.integers(1, 5), st.booleans(), st.integers(0, 30))
def test_batches_go_on_from_any_place(pairs, size, window, any_order, place):
    source = histories(pairs, rounds=5)
    examples = REGISTRY.get("posterior").examples
    with mock.patch.object(
        _batches, "SETTINGS", replace(_batches.SETTINGS, block_pairs=4, pool_blocks=2)
    ):  # so that there are several pools
        batches = Batches(lambda a, b: source.pairs(slice(a, b)), examples, pairs, size, window, 3, any_order)
        stream = batches.since(Place())
        seen = [next(stream) for _ in range(place + 2)]
        rounds, answers, after = next(batches.since(seen[place][2]))
    assert np.array_equal(rounds.measured, seen[place + 1][0].measured)
    assert np.array_equal(answers, seen[place + 1][1]) and after == seen[place + 1][2]
    assert rounds.rounds == window and 1 <= len(rounds) <= min(size, pairs)


def test_an_epoch_shows_no_pair_twice():
    source = histories(64, rounds=5)
    examples = REGISTRY.get("capture").examples
    asked = []

    def read(first, last):
        asked.append(last - first)
        return source.pairs(slice(first, last))

    with mock.patch.object(_batches, "SETTINGS", replace(_batches.SETTINGS, block_pairs=8, pool_blocks=2)):
        stream = Batches(read, examples, 64, 4, 4, 0).since(Place())
        first, second = (np.concatenate([next(stream)[0].target[:, 0] for _ in range(16)]) for _ in range(2))
        assert max(asked) == 8 and len(asked) == 16
    assert len(np.unique(first)) == 64
    assert np.array_equal(np.sort(first), np.sort(second)) and not np.array_equal(first, second)


def test_answers_are_the_next_parameters_and_last_the_target():
    source = histories(9, rounds=5)
    rounds, answers = REGISTRY.get("capture").examples(source)
    rounds, answers = windows(rounds, answers, 3, np.random.default_rng(0), any_order=False)
    for pair in range(9):
        first = np.flatnonzero((source.parameters[pair] == rounds.parameters[pair, 0]).all(axis=1))[0]
        following = np.concatenate([source.parameters[pair], source.target[pair][None]])
        assert np.array_equal(answers[pair], following[first + 1 : first + 4])


# --- what it writes ---


def test_a_checkpoint_says_what_it_is(trained, store):
    folder = trained("capture")
    document = json.loads((folder / "identifier.json").read_text())
    assert document["histories"]["rounds"] == 5 and document["histories"]["pairs"] == 1920
    assert document["result"]["pairs"] == {"trained": 1728, "held_out": 192}
    assert all(0.88 < share < 0.99 for share in document["result"]["coverage"].values())
    assert (folder / "loss.png").stat().st_size > 1000 and (folder / "provenance.json").is_file()
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == list(range(2, 101, 2))
    assert lines[-1]["validation_loss"] < 0.3 * lines[0]["validation_loss"]
    assert {a.dtype.name for a in load_file(folder / "identifier.safetensors").values()} == {
        "float32",
        "float64",
    }
    found = load_identifier(folder, Signature.from_document(Histories(store).attributes))
    assert found.name == "capture" and found.model.window == 4


@pytest.mark.parametrize("name", ["capture", "posterior"])
def test_training_and_validation_loss_are_the_same_quantity(name, tmp_path):
    """Of weights that do not move, over all pairs but those held out, and over all pairs there are."""
    rounds = histories(64, rounds=4)
    kind, where = REGISTRY.get(name), Device()
    architecture = Architecture(2, 2, 6, 2, window=4, width=16, layers=1, heads=2)
    trainer = Trainer(
        kind,
        TrainingHistories(SIGNATURE, lambda first, last: rounds.pairs(slice(first, last)), 64),
        architecture,
        Settings(steps=1, batch=32, learning_rate=1e-12, validation=0.5),
        where,
    )
    metrics = next(trainer.run())
    judged = trainer._judge(rounds.pairs(slice(0, 32)))
    of_trained = judged.likelihood if kind.likelihood else np.square(judged.error).mean()
    assert metrics["training_loss"] == pytest.approx(of_trained, rel=1e-3)


def test_early_stopping_keeps_the_best(small, tmp_path):
    document = train_sysid(
        histories=small, out=tmp_path / "c", patience=2, **{**TINY, "steps": 200, "learning_rate": 0.3}
    )
    result = document["result"]
    assert result["steps"] < 200 and result["steps"] - result["best_step"] == 8
    lines = [json.loads(line) for line in (tmp_path / "c" / "metrics.jsonl").read_text().splitlines()]
    assert result["validation_loss"] == min(line["validation_loss"] for line in lines)


def test_a_warm_up_is_not_ended_early(small, tmp_path):
    settings = {**TINY, "steps": 200, "learning_rate": 30.0, "warmup": 90}
    document = train_sysid(histories=small, out=tmp_path / "c", patience=2, **settings)
    assert document["result"]["steps"] >= 90


def test_a_training_that_stopped_early_says_so(small, tmp_path):
    sizes = [
        "--width",
        "16",
        "--layers",
        "1",
        "--heads",
        "2",
        "--steps",
        "200",
        "--batch",
        "16",
        "--lr",
        "0.3",
    ]
    options = ["--histories", str(small), "--out", str(tmp_path / "c"), "--patience", "2", *sizes]
    done = CliRunner().invoke(app, ["train-sysid", *options])
    assert done.exit_code == 0, done.output
    assert "where it stopped: nothing gained in 2 evaluations" in done.output


def test_from_the_command_line(small, tmp_path):
    out = str(tmp_path / "c")
    sizes = ["--width", "16", "--layers", "1", "--heads", "2", "--steps", "4", "--batch", "16"]
    options = ["--histories", str(small), "--out", out, "--precision", "bfloat16", *sizes]
    done = CliRunner().invoke(app, ["train-sysid", *options, "--json", "--quiet"])
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document == json.loads((tmp_path / "c" / "identifier.json").read_text())
    assert document["architecture"]["tokens"] == "step" and document["result"]["steps"] == 4
    again = CliRunner().invoke(app, ["train-sysid", *options])
    assert isinstance(again.exception, OutputError)
    shown = CliRunner().invoke(app, ["train-sysid", *options, "--force"])
    assert "capture for toy" in shown.stdout and "friction" in shown.stdout


# --- refusals ---


@pytest.mark.parametrize(
    "options, message",
    [
        ({"identifier": "least-squares"}, "learns nothing"),
        ({"identifier": "domain-randomization"}, "learns nothing"),
        ({"identifier": "captur"}, "unknown identifier"),
        ({"window": 6}, "have 5 rounds"),
        ({"identifier": "tunenet", "window": 3}, "reads 1 round"),
        ({"width": 30, "heads": 4}, "not a multiple"),
        ({"identifier": "posterior", "tokens": "word"}, "--tokens 'word'"),
        ({"tokens": "trajectory"}, "capture has one token a step"),
        ({"identifier": "capture-trajectory", "tokens": "step"}, "has one token a trajectory"),
        ({"validation": 1.0}, "--validation"),
        ({"learning_rate": 0.0}, "--lr"),
        ({"learning_rate": float("inf")}, "--lr inf"),
        ({"device": "gpu"}, "--device 'gpu'"),
        ({"precision": "half"}, "--precision 'half'"),
    ],
)
def test_options_that_cannot_be(small, tmp_path, options, message):
    with pytest.raises(OptionError, match=message):
        train_sysid(histories=small, out=tmp_path / "c", **{**TINY, **options})
    assert not any(tmp_path.iterdir())


def test_the_identifiers_that_a_cure_names_can_be_trained(small, tmp_path):
    with pytest.raises(OptionError) as caught:
        train_sysid(histories=small, out=tmp_path / "c", **{**TINY, "identifier": "captur"})
    assert "capture-refined" in caught.value.cure and "cma-es" not in caught.value.cure


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_not_there(small, tmp_path):
    with pytest.raises(OptionError, match="--device cuda"):
        train_sysid(histories=small, out=tmp_path / "c", device="cuda", **TINY)
    assert not any(tmp_path.iterdir())


def test_a_training_that_diverges(small, tmp_path):
    with pytest.raises(FitError, match="diverged: after step") as caught:
        train_sysid(histories=small, out=tmp_path / "c", **{**TINY, "learning_rate": 1e15})
    assert "--lr" in caught.value.cure and not (tmp_path / "c").exists()


def test_histories_with_nan(tmp_path):
    rounds = histories(40, rounds=4)
    rounds.measured[23, 2, 1, 0] = np.nan
    store = write(rounds, tmp_path / "h.zarr")
    with pytest.raises(StoreError, match="measured of pair 23"):
        train_sysid(histories=store, out=tmp_path / "c", **TINY)
    assert [p.name for p in tmp_path.iterdir()] == ["h.zarr"]


def test_histories_are_not_replaced_by_what_learns_from_them(small, tmp_path):
    for out in (small, small.parent):
        (out / "provenance.json").touch()
        with pytest.raises(OutputError, match="which is read"):
            train_sysid(histories=small, out=out, force=True, **TINY)
        (out / "provenance.json").unlink()
    assert len(Histories(small)) == 64


def test_too_few_histories(tmp_path):
    store = write(histories(5, rounds=4), tmp_path / "h.zarr")
    with pytest.raises(StoreError, match="holds 5 histories"):
        train_sysid(histories=store, out=tmp_path / "c", **TINY)


@pytest.fixture(scope="module")
def learned(small, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("learned") / "c"
    train_sysid(histories=small, out=out, **TINY)
    return out


@pytest.fixture
def checkpoint(learned, tmp_path) -> Path:
    """A copy, which may be damaged."""
    return shutil.copytree(learned, tmp_path / "c")


def changed(**parts) -> Signature:
    return Signature(**{**vars(SIGNATURE), **parts})


def test_of_many_differences_the_first_are_named():
    actions = [[Parameter(f"{name}{k}", "N", -1, 1, 0) for k in range(22)] for name in "ab"]
    mine, theirs = (changed(actions=ParameterSpace(a)) for a in actions)
    (line,) = mine.differences(theirs)
    assert line.startswith("actions: a0 [-1, 1] N, and here b0 [-1, 1] N; a1") and line.endswith(
        "; and 19 more"
    )
    assert mine.differences(changed(task="other", actions=ParameterSpace(actions[1]))) == [
        "the task 'toy', and this is 'other'"
    ]


@pytest.mark.parametrize(
    "other, message",
    [
        (changed(task="scooping"), "the task 'toy', and this is 'scooping'"),
        (
            changed(space=ParameterSpace([Parameter("mass", "kg", 0, 1, 0.5)])),
            r"parameters: .* mass \[0, 1\] kg",
        ),
        (changed(point_times=np.array([0.1, 0.2])), "points: 6 up to 1.2 s, and here 2 up to 0.2 s"),
        (changed(features=SIGNATURE.features[:1]), "features: "),
    ],
)
def test_a_checkpoint_of_something_else(checkpoint, other, message):
    with pytest.raises(OptionError, match=message):
        load_identifier(checkpoint, other)


@pytest.mark.parametrize(
    "damage, message",
    [
        (lambda c: (c / "identifier.safetensors").unlink(), "holds no identifier.safetensors"),
        (lambda c: (c / "identifier.safetensors").write_bytes(b"no"), "cannot be read"),
        (lambda c: (c / "identifier.json").unlink(), "holds no identifier.json"),
        (lambda c: edit(c, version=4), "version 4; this program reads 3"),
        (lambda c: edit(c, format="capture/policy"), "not of the format capture/identifier"),
        (lambda c: edit(c, signature={}), "cannot be read"),
        (lambda c: edit(c, architecture={"width": 8}), "cannot be read"),
        (lambda c: edit(c, architecture={**architecture(c), "heads": 0}), "heads is 0"),
        (lambda c: edit(c, architecture={**architecture(c), "heads": 3}), "not a multiple"),
        (lambda c: edit(c, architecture={**architecture(c), "layers": 10**18}), "has 10{18} layers"),
        (lambda c: edit(c, architecture={**architecture(c), "points": 10**18}), "its architecture is for"),
        (lambda c: edit(c, signature=SIGNATURE_OF_ONE), "as in its signature"),
        (lambda c: edit(c, identifier="compass"), "learns nothing"),
        (
            lambda c: weigh(c, "network.mean_head.bias", lambda a: a[:, None]),
            r"bias has shape \(\d, 1\), expected",
        ),
        (lambda c: weigh(c, "family.usual", lambda a: a[:0]), r"family.usual has shape \(0, 70\), expected"),
        (
            lambda c: weigh(c, "family.usual", lambda a: np.array(a[0, 0])),
            r"family.usual has shape \(\), expected",
        ),
        (
            lambda c: weigh(c, "normalisation.spread", lambda a: 0 * a),
            "spread holds 0, expected numbers above 0",
        ),
        (lambda c: weigh(c, "calibration.factor", lambda a: a[:1]), r"calibration.factor has shape \(1, "),
        (lambda c: weigh(c, "family.mean", lambda a: a[:2]), r"family.mean has shape \(2,\), expected"),
        (lambda c: weigh(c, "family.usual", lambda a: a[:, ::-1].copy()), "do not rise"),
        (lambda c: weigh(c, "network.mean_head.bias", lambda a: a * np.nan), "mean_head.bias is not finite"),
    ],
)
def test_a_checkpoint_that_is_damaged(checkpoint, damage, message):
    damage(checkpoint)
    with pytest.raises(StoreError, match=message):
        load_identifier(checkpoint)


SIGNATURE_OF_ONE = {**SIGNATURE.document(), "parameters": SIGNATURE.document()["parameters"][:1]}


def architecture(checkpoint: Path) -> dict:
    return json.loads((checkpoint / "identifier.json").read_text())["architecture"]


def weigh(checkpoint: Path, name: str, change) -> None:
    path = checkpoint / "identifier.safetensors"
    arrays = load_file(path)
    save_file({**arrays, name: change(arrays[name])}, path)


def edit(checkpoint: Path, **changes) -> None:
    path = checkpoint / "identifier.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def test_histories_of_another_version(small, tmp_path):
    copy = write(histories(20, rounds=4), tmp_path / "h.zarr")
    zarr.open_group(str(copy)).attrs["version"] = 99
    with pytest.raises(StoreError, match="version 99"):
        train_sysid(histories=copy, out=tmp_path / "c", **TINY)


def test_what_differs_of_a_long_text_is_shown():
    earlier, now = {"task": f"{'a' * 100}/one/task.toml"}, {"task": f"{'a' * 100}/two/task.toml"}
    with pytest.raises(OptionError, match=r"task was \.\.\.a*/one/task\.toml, now \.\.\.a*/two/task\.toml"):
        check_recipe(earlier, now)
