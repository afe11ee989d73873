"""A diagnosis that was interrupted goes on to the same bytes; other inputs or options are refused."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from held_inputs import held_machine
from inspecting import inspect
from setting_numbers import set_numbers

from capture_cli.errors import FitError, OptionError, OutputError
from capture_cli.select.candidates import all_candidates
from capture_cli.select.search import attribution, extension
from capture_cli.stages import diagnose as stage
from capture_cli.stages.diagnose import diagnose
from capture_cli.stages.record import record
from capture_cli.stages.search_checkpoint import STEPS, StepFiles
from capture_cli.store.output import unfinished

FEW = ("coulomb-friction", "cubic-stiffness", "control-lag")  # the last has a state
PLANTED = ["coulomb-friction@x.friction=1.5", "cubic-stiffness@x.stiffness=200"]


@pytest.fixture(autouse=True)
def few_candidates(monkeypatch):
    """A search among a few effects is a fast one."""
    whole = all_candidates
    monkeypatch.setattr(
        attribution, "all_candidates", lambda log: [c for c in whole(log) if c.placed.kind in FEW]
    )
    monkeypatch.setattr(stage, "_write_pages", lambda *_: None)


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    """Options of a diagnosis of a log with two effects, and what it is without an interruption."""
    folder = tmp_path_factory.mktemp("asked")
    options = {"task": str(held_machine(folder / "slider", "slider", 0.008)), "real_log": folder / "run.zarr"}
    making = {"noise": 5e-4, "rate": 125, "episodes": 4, "duration": 1.0, "seed": 3}
    record(task=options["task"], out=options["real_log"], effects=PLANTED, **making)
    return {**options, "threads": 1, "quiet": True}


@pytest.fixture(scope="module")
def whole(asked, tmp_path_factory):
    """The diagnosis without an interruption, and how many steps it took."""
    out = tmp_path_factory.mktemp("whole") / "d"
    with pytest.MonkeyPatch.context() as patch:
        few_candidates.__wrapped__(patch)
        steps = steps_made(patch)
        diagnose(out=out, **asked)
    return out, len(steps)


def steps_made(monkeypatch, most: int | None = None) -> list[str]:
    """Names of the steps that are made, and not read, from here on; it is interrupted when they are `most`."""
    names, step = [], StepFiles.step

    def noted(self, name, given, make):
        def make_noted():
            if len(names) == most:
                raise KeyboardInterrupt
            names.append(name)
            return make()

        return step(self, name, given, make_noted)

    monkeypatch.setattr(StepFiles, "step", noted)
    return names


def interrupted(out: Path, asked: dict, *, after: int) -> str:
    """What a diagnosis that is interrupted after so many steps says."""
    with pytest.MonkeyPatch.context() as patch:
        steps_made(patch, most=after)
        with pytest.raises(KeyboardInterrupt) as caught:
            diagnose(out=out, **asked)
    return str(caught.value)


def files(folder: Path) -> dict[str, bytes]:
    """All that was found, and nothing of when."""
    every = [f for f in folder.rglob("*") if f.is_file() and f.name != "provenance.json"]
    assert len(every) > 10
    return {str(f.relative_to(folder)): f.read_bytes() for f in every}


def test_it_goes_on_to_the_same_bytes(asked, whole, tmp_path, monkeypatch):
    out, (uninterrupted, steps) = tmp_path / "d", whole
    after = round(0.8 * steps)
    said = interrupted(out, asked, after=after)
    assert said.startswith("interrupted: what was worked out is kept; so far")
    assert "cure: go on with the same command and --resume" in said
    assert not out.exists()
    assert len(list((unfinished(out) / STEPS).iterdir())) == after
    again = steps_made(monkeypatch)
    diagnose(out=out, resume=True, **asked)
    assert len(again) == steps - after
    assert files(out) == files(uninterrupted)
    assert not unfinished(out).exists()


def test_what_does_not_fit_into_the_room_is_made_again(asked, whole, tmp_path, monkeypatch):
    out, (uninterrupted, steps) = tmp_path / "d", whole
    set_numbers(monkeypatch, "capture_cli.stages.search_checkpoint", most=2e5)
    interrupted(out, asked, after=steps - 5)
    kept = list((unfinished(out) / STEPS).iterdir())
    assert 0 < len(kept) < steps - 5
    assert sum(path.stat().st_size for path in kept) < 2.2e5
    diagnose(out=out, resume=True, **asked)
    assert files(out) == files(uninterrupted)


def test_what_was_found_is_said_and_how_to_end_sooner(asked, whole, tmp_path):
    _, steps = whole
    said = interrupted(tmp_path / "d", asked, after=steps - 5)
    so_far = said.partition("so far: ")[2].partition("\n")[0]
    assert set(so_far.split(", ")) == {"coulomb-friction@x", "cubic-stiffness@x"}
    assert "with --most-effects 2 it ends sooner" in said
    # how far to go may be said anew
    found = diagnose(out=tmp_path / "d", resume=True, **asked, most_effects=2, expression=False)
    assert len(found.document["effects"]) == 2


def test_another_run_is_refused(asked, whole, tmp_path):
    out, task = tmp_path / "d", Path(asked["task"])
    interrupted(out, asked, after=2)
    kept = sorted(unfinished(out).rglob("*"))
    with pytest.raises(OutputError, match=r"an earlier run left .* unfinished") as caught:
        diagnose(out=out, **asked)
    assert "--resume" in caught.value.cure and "--force" in caught.value.cure
    with pytest.raises(OptionError, match=r"the earlier run differs: options\.seed was 0, now 1\n") as caught:
        diagnose(out=out, resume=True, seed=1, **asked)
    assert "--force" in caught.value.cure
    model = task.with_name("model.xml")
    assert model.is_file()
    text = model.read_text()
    try:
        model.write_text(text + "<!-- another -->")
        with pytest.raises(
            OptionError, match=r"the earlier run differs: inputs\.model was \w{12}, now \w{12}\n"
        ):
            diagnose(out=out, resume=True, **asked)
    finally:
        model.write_text(text)
    other = tmp_path / "other.zarr"
    record(task=str(task), out=other, noise=5e-4, rate=125, episodes=8, duration=1.0, seed=4)
    with pytest.raises(
        OptionError, match=r"the earlier run differs: inputs\.real_log was \w{12}, now \w{12}\n"
    ):
        diagnose(out=out, resume=True, **{**asked, "real_log": other})
    assert sorted(unfinished(out).rglob("*")) == kept
    found = diagnose(out=out, force=True, **{**asked, "real_log": other})
    assert found.document["verdict"] == "explained"


def test_other_code_is_refused(asked, tmp_path, monkeypatch):
    interrupted(tmp_path / "d", asked, after=1)
    monkeypatch.setattr("capture_cli.store.provenance.code_hash", lambda: "0" * 64)
    with pytest.raises(OptionError, match=r"the earlier run differs: code was \w{12}, now 000000000000\n"):
        diagnose(out=tmp_path / "d", resume=True, **asked)


def test_one_that_is_complete_is_read(asked, whole, monkeypatch):
    out, _ = whole
    steps, before = steps_made(monkeypatch), files(out)
    assert diagnose(out=out, resume=True, **asked).document == json.loads(before["diagnosis.json"])
    for changed in ({"seed": 1}, {"most_effects": 1}):
        with pytest.raises(OptionError, match=f"options.{next(iter(changed))} was "):
            diagnose(out=out, resume=True, **asked, **changed)
    with pytest.raises(OutputError, match="exists already"):
        diagnose(out=out, **asked)
    assert not steps and files(out) == before


def test_a_step_that_is_damaged_is_made_again(asked, whole, tmp_path, monkeypatch):
    out, (uninterrupted, steps) = tmp_path / "d", whole
    interrupted(out, asked, after=6)
    second = sorted((unfinished(out) / STEPS).iterdir())[1]
    second.write_bytes(second.read_bytes()[:1000])
    again = steps_made(monkeypatch)
    diagnose(out=out, resume=True, **asked)
    assert len(again) == steps - 5
    assert files(out) == files(uninterrupted)


def test_interrupted_while_it_writes_it_goes_on(asked, whole, tmp_path, monkeypatch):
    out, (uninterrupted, _) = tmp_path / "d", whole

    def stop(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(stage, "_write_pages", stop)
        with pytest.raises(KeyboardInterrupt, match=r"what was worked out is kept\n  cure: .* --resume"):
            diagnose(out=out, **asked)
    steps = steps_made(monkeypatch)
    diagnose(out=out, resume=True, **asked)
    assert not steps and files(out) == files(uninterrupted)


def test_a_formula_is_gone_on_with(asked, tmp_path, monkeypatch):
    monkeypatch.setattr(
        attribution,
        "all_candidates",
        lambda log: [c for c in all_candidates(log) if c.name in ("bias@drive",)],
    )
    out, kept = tmp_path / "d", tmp_path / "kept"
    monkeypatch.setattr(stage, "_write_pages", lambda *_: shutil.copytree(unfinished(out), kept))
    found = diagnose(out=out, **asked)
    assert found.document["expression"] is not None
    for last in sorted((kept / STEPS).iterdir())[-3:]:  # as if it had been interrupted before them
        last.unlink()
    for written in kept.glob("diagnosis.*"):
        shutil.rmtree(written) if written.is_dir() else written.unlink()
    whole = files(out)
    shutil.rmtree(out)
    kept.rename(unfinished(out))
    monkeypatch.setattr(stage, "_write_pages", lambda *_: None)
    again = steps_made(monkeypatch)
    diagnose(out=out, resume=True, **asked)
    assert len(again) == 3 and files(out) == whole


def test_what_cannot_be_fitted_leaves_nothing(asked, tmp_path, monkeypatch):
    def diverged(*_, **__):
        raise FitError("every simulation diverged", cure="mend the model")

    monkeypatch.setattr(extension, "BalanceRound", diverged)
    with pytest.raises(FitError):
        diagnose(out=tmp_path / "d", **asked)
    assert list(tmp_path.iterdir()) == []


PROGRAM = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs start with it ignored
from capture_cli import cli
from capture_cli.stages.search_checkpoint import StepFiles

step = StepFiles.step

def third_for_ever(self, *arguments):
    if self._number == 2:
        print("fitting", file=sys.stderr, flush=True)
        while True:
            time.sleep(0.01)
    return step(self, *arguments)

StepFiles.step = third_for_ever
cli.main()
"""


def test_a_signal_keeps_what_was_made(asked, tmp_path):
    options = ["--real-log", asked["real_log"], "--task", asked["task"], "--out", "d", "--quiet"]
    command = [sys.executable, "-c", PROGRAM, "diagnose", *map(str, options)]
    run = subprocess.Popen(command, stdout=-1, stderr=-1, text=True, cwd=tmp_path)
    assert run.stderr.readline() == "fitting\n"
    run.send_signal(signal.SIGTERM)
    out, err = run.communicate()
    assert (run.returncode, out) == (143, "")
    assert err == (
        "interrupted: what was worked out is kept; so far no effect was found\n"
        "  cure: go on with the same command and --resume\n"
    )
    assert len(list((unfinished(tmp_path / "d") / STEPS).iterdir())) == 2


def test_before_the_first_step_nothing_is_kept(asked, tmp_path):
    assert interrupted(tmp_path / "d", asked, after=0) == (
        "interrupted: nothing was written; so far no effect was found\n  cure: run the same command again"
    )
    assert list(tmp_path.iterdir()) == []


def test_an_unfinished_one_says_how_to_go_on(asked, tmp_path):
    interrupted(tmp_path / "d", asked, after=2)
    document = inspect(unfinished(tmp_path / "d"))
    assert (document["kind"], document["result"]["command"]) == ("unfinished", "diagnose")
    (found,) = document["findings"]
    assert (
        found["message"] == "an unfinished diagnosis, of which 2 steps are kept"
        and "--resume" in found["cure"]
    )
