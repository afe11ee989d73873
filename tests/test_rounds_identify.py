"""Rounds over a log: what is proposed, what physics makes of it, when it is not believed, and how it goes on."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from episodes_of import episodes_of
from toy_rounds import SIGNATURE, histories, write

from capture_cli.context.checkpoints.identifier_checkpoint import load_identifier
from capture_cli.context.histories.action_library import log_sequences
from capture_cli.context.identifiers._family import Family
from capture_cli.context.identifiers._normalisation import Normalisation
from capture_cli.context.identifiers.base import Rounds
from capture_cli.errors import FitError, LogError, OptionError, StoreError
from capture_cli.estimate.prepare import prepare
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.model_hash import model_hash
from capture_cli.model.tasks import load_task
from capture_cli.stages.gen_histories import gen_histories
from capture_cli.stages.identify import identify
from capture_cli.stages.record import record
from capture_cli.stages.train_sysid import train_sysid
from capture_cli.store.estimate import HISTORY, Estimate

pytestmark = pytest.mark.usefixtures("without_pages")
TINY = {"width": 16, "layers": 1, "heads": 2, "steps": 150, "batch": 32, "warmup": 10}


@pytest.fixture(scope="module")
def scooping(tmp_path_factory, learn) -> Path:
    """A folder with a checkpoint `c`, trained for a moment, and a log of 8 lifts."""
    folder = tmp_path_factory.mktemp("scooping")
    gen_histories(task="scooping", out=folder / "h.zarr", pairs=120, rounds=4, threads=1, quiet=True)
    train_sysid(histories=folder / "h.zarr", out=folder / "c", identifier="posterior", **TINY)
    record(
        task="scooping",
        out=folder / "log.zarr",
        parameters={"com": 0.33},
        noise=3e-4,
        episodes=8,
        seed=1,
        threads=1,
    )
    return folder


@pytest.fixture(scope="module")
def found(scooping) -> Estimate:
    return proposed_and_refined(scooping, scooping / "log.zarr", scooping / "e")


def proposed_and_refined(scooping: Path, log: Path, out: Path, **options) -> Estimate:
    """The estimate of `log` by the checkpoint, on one thread unless told otherwise."""
    options = {"threads": 1, "quiet": True, **options}
    return identify(real_log=log, out=out, identifier=str(scooping / "c"), **options)


def test_a_learned_identifier_proposes_and_physics_refines(found, scooping):
    document, com = found.document, found.document["parameters"]["com"]
    about = document["in_context"]
    assert abs(com["value"] - 0.33) < 4 * com["sd"] < 0.2
    assert document["identifier"] == "posterior"
    assert document["verdict"] == "explained"
    assert about["rounds"] == about["episodes"] == document["split"]["fit_windows"] == 6
    assert not about["fallback"]
    estimates = [r["parameters"]["com"] for r in document["rounds"][: about["rounds"]]]
    assert estimates[-1] == about["proposal"]["com"]
    assert found.arrays[HISTORY[0]].shape == (6, 1)
    # in round i the log's own action drove what was measured, and what was simulated
    log = MeasuredLog.read(scooping / "log.zarr")
    assert all(any(np.array_equal(a, b) for b in log.actions) for a in found.arrays[HISTORY[1]])
    assert set(np.unique(found.arrays[HISTORY[3]])) <= {-1.0, 0.0, 1.0}


def test_the_same_again_for_any_number_of_threads(found, scooping, tmp_path):
    again = proposed_and_refined(scooping, scooping / "log.zarr", tmp_path / "e", threads=2)
    assert again.document == found.document
    assert all(np.array_equal(again.arrays[name], array) for name, array in found.arrays.items())


def test_episodes_are_cycled_where_rounds_are_more_and_it_says_so(scooping, tmp_path):
    estimate = proposed_and_refined(scooping, scooping / "log.zarr", tmp_path / "e", rounds=9)
    about = estimate.document["in_context"]
    assert (about["rounds"], about["episodes"]) == (9, 6)
    assert "9 rounds were made with 6 episodes" in about["text"]


def test_a_log_that_no_parameter_explains_is_not_left_to_the_proposal(scooping, tmp_path):
    record(
        task="scooping",
        out=tmp_path / "log.zarr",
        parameters={"com": 0.33},
        effects=["sensor-scale@rod_tilt.change=-0.5"],
        noise=3e-4,
        episodes=8,
        seed=1,
        threads=1,
    )
    document = proposed_and_refined(scooping, tmp_path / "log.zarr", tmp_path / "e").document
    assert document["verdict"] == "unexplained"
    assert document["in_context"]["fallback"]
    assert "Physics was asked from several places" in document["in_context"]["text"]


def test_an_estimate_is_taken_up_with_the_episodes_that_are_new(scooping, tmp_path):
    log = MeasuredLog.read(scooping / "log.zarr")
    episodes_of(log, range(5)).write(tmp_path / "log.zarr")
    options = {"out": tmp_path / "e", "threads": 1, "quiet": True}
    first = identify(real_log=tmp_path / "log.zarr", identifier=str(scooping / "c"), **options)
    with pytest.raises(OptionError, match=r"no episode that is not in .*"):
        identify(real_log=tmp_path / "log.zarr", resume=True, **options)
    shutil.rmtree(tmp_path / "log.zarr")
    log.write(tmp_path / "log.zarr")
    second = identify(real_log=tmp_path / "log.zarr", resume=True, **options)
    assert second.document["identifier"] == "posterior"  # as it was begun
    assert second.document["rollouts"]["measured"] == 8
    before = len(first.document["rounds"])
    assert second.document["rounds"][:before] == first.document["rounds"]
    old, new = first.arrays[HISTORY[1]], second.arrays[HISTORY[1]]
    assert np.array_equal(new[: len(old)], old)
    assert not any(np.array_equal(a, b) for a in new[len(old) :] for b in log.actions[:5])
    # its rounds begin where the earlier estimate was
    assert second.arrays[HISTORY[0]][len(old)] == pytest.approx(first.arrays["parameter/estimate"])
    tests = [e.arrays["window/episode"][e.arrays["window/is_test"]].tolist() for e in (first, second)]
    assert tests[1][: len(tests[0])] == tests[0]
    assert abs(second.document["parameters"]["com"]["value"] - 0.33) < 0.05


def test_an_estimate_is_taken_up_with_its_seed_or_the_one_that_is_given(scooping, tmp_path):
    log = MeasuredLog.read(scooping / "log.zarr")
    episodes_of(log, range(5)).write(tmp_path / "log.zarr")
    options = {"real_log": tmp_path / "log.zarr", "threads": 1, "quiet": True}
    identify(**options, out=tmp_path / "e", identifier="least-squares", starts=1, seed=4)
    shutil.rmtree(tmp_path / "log.zarr")
    log.write(tmp_path / "log.zarr")
    for given, kept in ((None, 4), (0, 0)):
        shutil.copytree(tmp_path / "e", out := tmp_path / f"e{given}")
        identify(**options, out=out, starts=1, resume=True, seed=given)
        assert json.loads((out / "provenance.json").read_text())["options"]["seed"] == kept


def test_only_the_log_that_was_begun_with_is_gone_on_with(found, scooping, tmp_path):
    shutil.copytree(scooping / "e", tmp_path / "e")
    log = MeasuredLog.read(scooping / "log.zarr")
    episodes_of(log, [1, 0, *range(2, 8), 0]).write(tmp_path / "log.zarr")
    before = (tmp_path / "e" / "estimate.json").read_bytes()
    with pytest.raises(OptionError, match="made from other episodes"):
        identify(real_log=tmp_path / "log.zarr", out=tmp_path / "e", resume=True, quiet=True)
    assert (tmp_path / "e" / "estimate.json").read_bytes() == before


def test_checkpoints_that_are_of_no_use_are_refused(scooping, slider_task, tmp_path):
    options = {"out": tmp_path / "e", "quiet": True}
    log = scooping / "log.zarr"
    with pytest.raises(OptionError, match=r"must be trained"):
        identify(real_log=log, identifier="posterior", **options)
    with pytest.raises(OptionError, match=r"no identifier\.json"):
        identify(real_log=log, identifier=str(scooping), **options)
    damaged = shutil.copytree(scooping / "c", tmp_path / "c")
    document = json.loads((damaged / "identifier.json").read_text())
    (damaged / "identifier.json").write_text(json.dumps({**document, "version": 9}))
    with pytest.raises(StoreError, match="version 9"):
        identify(real_log=log, identifier=str(damaged), **options)
    record(task=str(slider_task), out=tmp_path / "s.zarr", duration=2, amplitude={"drive": 5}, threads=1)
    with pytest.raises(OptionError, match="was trained for the task 'scooping'"):
        identify(
            real_log=tmp_path / "s.zarr", task=str(slider_task), identifier=str(scooping / "c"), **options
        )
    assert not (tmp_path / "e").exists()


def test_episodes_that_end_early_are_refused(scooping, tmp_path):
    log = MeasuredLog.read(scooping / "log.zarr")
    keep = np.concatenate([np.arange(e.start, e.stop - 15) for e in log.episodes])
    ends = np.cumsum([e.stop - 15 - e.start for e in log.episodes])
    fields = {n: getattr(log, n)[keep] for n in ("time", "inputs", "outputs")}
    MeasuredLog(**{**vars(log), **fields, "episode_ends": ends}).write(tmp_path / "log.zarr")
    with pytest.raises(LogError, match="lasts"):
        identify(
            real_log=tmp_path / "log.zarr", out=tmp_path / "e", identifier=str(scooping / "c"), quiet=True
        )


@pytest.mark.usefixtures("learn")
def test_a_machine_of_ones_own_from_its_log_to_an_identifier_of_its_own(slider_task, tmp_path):
    record(
        task=str(slider_task),
        out=tmp_path / "log.zarr",
        parameters={"mass": 2.2, "damping": 3.0},
        noise=1e-4,
        duration=6,
        amplitude={"drive": 8},
        rate=200,
        threads=1,
    )
    gen_histories(
        task=str(slider_task),
        inputs_from=tmp_path / "log.zarr",
        out=tmp_path / "h.zarr",
        pairs=100,
        rounds=4,
        threads=1,
        quiet=True,
    )
    train_sysid(histories=tmp_path / "h.zarr", out=tmp_path / "c", identifier="capture", **TINY)
    document = identify(
        real_log=tmp_path / "log.zarr",
        task=str(slider_task),
        out=tmp_path / "e",
        identifier=str(tmp_path / "c"),
        threads=1,
        quiet=True,
    ).document
    assert document["verdict"] == "explained"
    assert "another model" not in (document["in_context"]["text"] or "")
    for name, truth in (("mass", 2.2), ("damping", 3.0)):
        p = document["parameters"][name]
        assert abs(p["value"] - truth) < 4 * p["sd"]
    assert document["in_context"]["rounds"] == document["split"]["fit_windows"] == 9


def test_strokes_need_not_reach_every_wall_in_context(tmp_path):
    """Two strokes, of which none touches the right wall: a loop that begins with them goes on from there."""
    record(task="air-hockey", out=tmp_path / "log.zarr", episodes=2, noise=1e-3, seed=3, threads=1)
    options = {"real_log": tmp_path / "log.zarr", "out": tmp_path / "e", "test": "none", "quiet": True}
    document = identify(**options, threads=1).document
    assert document["in_context"]["rounds"] == 2
    assert not document["parameters"]["right_damping"]["identifiable"]
    assert any("right_damping" in u["combination"] for u in document["undetermined"])
    with pytest.raises(FitError, match="right_damping moves no output"):
        identify(**options, identifier="least-squares", force=True, threads=1)


def test_noise_that_training_had_not_does_not_put_a_log_outside(scooping):
    """A family of smooth trajectories: noise alone lies off their surface, and is allowed for."""
    trained, held_out, seen = (histories(600, seed=seed) for seed in range(3))
    family = Family.fitted(Normalisation.fitted(SIGNATURE, trained), trained, held_out)
    noise = np.array([2e-3, 2e-3])
    noisy = seen.measured + noise * np.random.default_rng(0).standard_normal(seen.measured.shape)
    seen = Rounds(seen.parameters, seen.actions, seen.simulated, noisy)
    assert np.mean(family.share_beyond(seen) < 0.01) > 0.9
    assert np.mean(family.with_noise(noise).share_beyond(seen) < 0.01) < 0.05
    moved = Rounds(seen.parameters, seen.actions, seen.simulated, noisy + 0.1)
    assert np.mean(family.with_noise(noise).share_beyond(moved) < 0.01) > 0.9


@pytest.mark.usefixtures("learn")
def test_noise_that_training_had_is_not_counted_again(tmp_path):
    """New histories of the very kind trained on: as many lie beyond any distance as of those held out."""
    floor = np.array([5e-3, 5e-3])

    def noisy(pairs: int, seed: int) -> Rounds:
        rounds = histories(pairs, seed=seed)
        drawn = np.random.default_rng(seed).standard_normal(rounds.measured.shape)
        return replace(rounds, measured=rounds.measured + floor * drawn)

    store = write(noisy(960, 0), tmp_path / "h.zarr", noise="none", noise_sd={"x": floor[0], "y": floor[1]})
    train_sysid(histories=store, out=tmp_path / "c", **{**TINY, "steps": 1}, validation=0.3)
    checkpoint = load_identifier(tmp_path / "c")
    share = checkpoint.model.family.with_noise(checkpoint.noise_beyond(floor)).share_beyond(noisy(400, 1))
    assert 0.3 < np.median(share) < 0.7
    louder = checkpoint.noise_beyond(3 * floor)
    assert np.all(2 * floor < louder) and np.all(louder < 3 * floor)


def test_noise_by_which_training_was_scaled_grows_with_what_is_measured(scooping):
    checkpoint = load_identifier(scooping / "c")
    floor = np.array([1e-3])
    assert checkpoint.noise_beyond(floor) is floor  # as it was trained without any
    noisy = {**checkpoint.record.histories, "noise": "scale"}
    checkpoint = replace(checkpoint, record=replace(checkpoint.record, histories=noisy))
    had = 0.1 / np.sqrt(3) * checkpoint.model.normalisation.sizes
    assert checkpoint.noise_beyond(floor) == pytest.approx(np.sqrt(np.maximum(floor**2 - had**2, 0)))
    assert not checkpoint.noise_beyond(had.min(axis=0)).any()


def driven(slider_task: Path) -> dict[str, Any]:
    """Options of a log of four seconds of the slider."""
    return {"task": str(slider_task), "duration": 4, "amplitude": {"drive": 8}, "rate": 100, "threads": 1}


def test_rounds_read_no_sample_that_was_held_out(slider_task, tmp_path):
    """Also where rounds last longer than windows, which then do not all begin one: no two rounds share samples."""
    task = load_task(str(slider_task))
    record(out=tmp_path / "log.zarr", **driven(slider_task))
    log = MeasuredLog.read(tmp_path / "log.zarr")
    wide, narrow = (prepare(log, task, window=w) for w in (0.5, 0.25))
    times = np.linspace(0, 0.5, 6)
    for prepared, tapes, left_out in ((wide, 6, 0), (narrow, 6, 6)):
        fitted = prepared.part(~prepared.split.is_test)
        held = np.arange(len(log.time)) >= (fitted.windows.first + fitted.windows.samples)[-1]
        found = log_sequences(fitted, times)
        assert (len(found.outputs), found.left_out) == (tapes, left_out)
        moved = replace(fitted, log=replace(log, outputs=log.outputs + held[:, None]))
        assert np.array_equal(log_sequences(moved, times).outputs, found.outputs)
        # the end of the last is told from the samples before it
        assert found.outputs[-1, -1] == pytest.approx(log.outputs[np.flatnonzero(held)[0]], abs=5e-4)
    with pytest.raises(LogError, match=r"nowhere 3\.5 s"):
        log_sequences(fitted, np.array([0, 3.5]))


@pytest.mark.usefixtures("learn")
def test_windows_that_begin_no_round_are_counted_and_another_model_is_noticed(slider_task, tmp_path):
    record(out=tmp_path / "log.zarr", **driven(slider_task))
    options = {"task": str(slider_task), "threads": 1, "quiet": True}
    gen_histories(**options, out=tmp_path / "h.zarr", pairs=40, rounds=3, amplitude={"drive": 8})
    train_sysid(histories=tmp_path / "h.zarr", out=tmp_path / "c", **{**TINY, "steps": 1})
    about = identify(
        **options,
        real_log=tmp_path / "log.zarr",
        window=0.25,
        identifier=str(tmp_path / "c"),
        out=tmp_path / "e",
    ).document["in_context"]
    assert about["episodes"] == 6
    assert "6 of 12 fitted windows begin no round, which lasts 0.5 s" in about["text"]
    assert "another model" not in about["text"]
    model = slider_task.with_name("model.xml")
    model.write_text(model.read_text().replace('axis="1 0 0"', 'axis="1 0 0" stiffness="3"'))
    changed = identify(
        **options, real_log=tmp_path / "log.zarr", identifier=str(tmp_path / "c"), out=tmp_path / "e2"
    ).document
    assert "histories of another model" in changed["in_context"]["text"]


ROOT = Path(__file__).resolve().parents[1]
SHIPPED = [
    path.parent.relative_to(ROOT).as_posix()
    for folder in ("capture_cli/checkpoints", "runs/sysid")
    for path in sorted((ROOT / folder).rglob("identifier.json"))
]


@pytest.mark.parametrize("folder", SHIPPED)
def test_what_is_shipped_was_trained_on_the_model_as_it_is(folder):
    histories = json.loads((ROOT / folder / "identifier.json").read_text())
    found = model_hash(load_task(histories["task"]).model)
    assert histories["histories"]["model"] == found


def test_how_contacts_are_searched_makes_no_other_model():
    model = load_task("air-hockey").model
    before = model_hash(model)
    searched = int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    assert model.opt.disableflags & searched
    model.opt.disableflags &= ~searched
    assert model_hash(model) == before
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    assert model_hash(model) != before
