"""propose, record, import-log --append and identify --resume: each alone, and the scripts of docs/ that join them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from warm_capture import warm_capture

from capture_cli.cli import main
from capture_cli.errors import LogError, OptionError, OutputError, StoreError
from capture_cli.log.arrays import Log, slices_until
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import cut
from capture_cli.stages.diagnose import diagnose
from capture_cli.stages.identify import identify
from capture_cli.stages.import_log import import_log
from capture_cli.stages.propose import propose
from capture_cli.stages.record import record
from capture_cli.stages.recorded.recorded_estimate import EarlierEstimate
from capture_cli.store.estimate import Estimate

DOCS = Path(__file__).parents[1] / "docs"
pytestmark = pytest.mark.usefixtures("without_pages")


@pytest.fixture(scope="module")
def scooping(tmp_path_factory) -> Path:
    """A folder with a log of two lifts, and its estimate `e`."""
    folder = tmp_path_factory.mktemp("scooping")
    options = {"task": "scooping", "parameters": {"com": 0.4}, "noise": 3e-4, "threads": 1}
    record(out=folder / "log.zarr", episodes=2, **options)
    record(out=folder / "other.zarr", seed=5, **options)
    identify(real_log=folder / "log.zarr", out=folder / "e", test="none", threads=1, quiet=True)
    return folder


def test_the_action_that_tells_most_is_proposed_again_for_the_same_seed(scooping):
    few = {"result": scooping / "e", "candidates": 8}
    first = propose(**few, threads=1, seed=3)
    assert first == propose(**few, threads=2, seed=3)
    assert first != propose(**few, threads=1, seed=4)
    action = first["action"]["scoop_point"]
    assert -1 <= action["value"] <= 1
    assert action["unit"] == "1"
    assert first["information"] > 0


def test_a_proposal_is_what_record_runs(scooping, tmp_path):
    proposal = propose(result=scooping / "e", candidates=8, threads=1)
    (tmp_path / "p.json").write_text(json.dumps(proposal))
    made = record(task="scooping", out=tmp_path / "n.zarr", actions_from=tmp_path / "p.json", threads=1)
    assert made.log.actions.tolist() == [[proposal["action"]["scoop_point"]["value"]]]
    others = [{"task": "air-hockey"}, {"action": {}}]
    others += [{"action": {"scoop_point": value}} for value in (0.1, {}, {"value": "far"}, {"value": np.nan})]
    for bad in ("{", *(json.dumps({**proposal, **other}) for other in others)):
        (tmp_path / "p.json").write_text(bad)
        with pytest.raises(
            OptionError, match=r"holds no action|is not JSON|value = nan; expected a finite number"
        ):
            record(task="scooping", out=tmp_path / "m.zarr", actions_from=tmp_path / "p.json")
    assert not (tmp_path / "m.zarr").exists()


def test_of_a_policy_its_own_action_is_proposed(scooping):
    assert propose(result=scooping / "e", policy="random", seed=1)["kind"] == "action"
    with pytest.raises(OptionError, match="neither a policy nor"):
        propose(result=scooping / "e", policy="nobody")
    with pytest.raises(OptionError, match="is driven by actions"):
        propose(result=scooping / "e", amplitude={"spatula_x_target": 1.0})


def test_a_machine_is_driven_no_further_than_its_log_was_wherever_that_is(slider_task, tmp_path, monkeypatch):
    """Also by estimates of before they kept the peaks, as long as the log is found as it was."""
    options = {"task": str(slider_task), "threads": 1}
    monkeypatch.chdir(tmp_path)
    Path("a").mkdir()
    record(out=Path("a/s.zarr"), duration=4, amplitude={"drive": 2}, noise=1e-3, rate=200, **options)
    identify(real_log=Path("a/s.zarr"), out=Path("a/e"), starts=1, quiet=True, **options)
    again = {"result": tmp_path / "a" / "e", "task": str(slider_task), "threads": 1}
    first = propose(**again)
    assert first["peaks"]["drive"] == pytest.approx(2)
    (tmp_path / "b").mkdir()
    monkeypatch.chdir(tmp_path / "b")
    assert propose(**again) == first
    document = json.loads((again["result"] / "estimate.json").read_text())
    assert document["log"].pop("input_peaks") == {"drive": pytest.approx(2)}
    (again["result"] / "estimate.json").write_text(json.dumps(document))
    assert propose(**again) == first
    (tmp_path / "a" / "s.zarr").rename("moved.zarr")
    with pytest.raises(
        OptionError, match=r"log a/s.zarr went, and it is neither here nor beside it"
    ) as caught:
        propose(**again)
    assert "--amplitude INPUT=VALUE" in caught.value.cure
    assert propose(**again, amplitude={"drive": 2})["peaks"]["drive"] == pytest.approx(2)
    record(out=tmp_path / "a" / "s.zarr", duration=4, amplitude={"drive": 9}, rate=200, force=True, **options)
    with pytest.raises(OptionError, match="has changed since"):
        propose(**again)


def test_a_proposal_as_a_csv_is_in_the_columns_and_units_of_the_log(
    slider_task, tmp_path, capsys, monkeypatch
):
    text = slider_task.read_text()
    old = 'column = "u_N"\n'
    assert old in text
    slider_task.write_text(
        text.replace(old, 'column = "drive [mN], set"\ncolumn_unit = "mN"\noffset = 0.5\n')
        + "time_scale = 1e-3\n"
    )
    options = {"task": str(slider_task), "threads": 1}
    record(out=tmp_path / "s.zarr", duration=3, amplitude={"drive": 5}, noise=1e-3, rate=100, **options)
    identify(real_log=tmp_path / "s.zarr", out=tmp_path / "e", starts=1, quiet=True, **options)
    monkeypatch.setattr(
        sys, "argv", ["capture", "propose", str(tmp_path / "e"), "--csv", str(tmp_path / "p.csv")]
    )
    with pytest.raises(SystemExit, match=r"^0$"):
        main()
    proposal = json.loads(capsys.readouterr().out)
    head, *rows = (tmp_path / "p.csv").read_text().splitlines()
    assert head == 't_s,"drive [mN], set"'
    time, drive = np.array([row.split(",") for row in rows], dtype=float).T
    np.testing.assert_allclose(1e-3 * time, proposal["time_s"], rtol=1e-7)
    np.testing.assert_allclose(1e-3 * drive + 0.5, proposal["inputs"]["drive"], rtol=1e-7, atol=1e-9)
    for read in (slider_task, tmp_path / "e"):
        with pytest.raises(OutputError, match=r"--csv .* which is read"):
            propose(result=tmp_path / "e", csv=read, threads=1)


def test_a_machine_of_ones_own_is_to_be_driven_by_a_multisine(slider_task, tmp_path):
    options = {"task": str(slider_task), "threads": 1}
    record(out=tmp_path / "s.zarr", duration=4, amplitude={"drive": 5}, noise=1e-3, rate=200, **options)
    identify(real_log=tmp_path / "s.zarr", out=tmp_path / "e", starts=1, quiet=True, **options)
    proposal = propose(result=tmp_path / "e", threads=1)
    tape = np.array(proposal["inputs"]["drive"])
    assert proposal["kind"] == "inputs"
    assert len(tape) == len(proposal["time_s"])
    assert np.abs(tape).max() == pytest.approx(proposal["peaks"]["drive"]) == pytest.approx(5)
    less = propose(result=tmp_path / "e", amplitude={"drive": 1}, threads=1)
    assert less["information"] < proposal["information"]
    with pytest.raises(OptionError, match="has no input 'motor'"):
        propose(result=tmp_path / "e", amplitude={"motor": 1})
    for none in (-3.0, 0.0, float("nan")):
        with pytest.raises(
            OptionError, match=rf"--amplitude drive={none:g}: .* is a number above 0"
        ) as caught:
            propose(result=tmp_path / "e", amplitude={"drive": none}, threads=1)
        assert "in N, or leave it out to go as far as the log did" in caught.value.cure


def test_proposed_inputs_are_recorded_appended_and_taken_up(slider_task, tmp_path):
    options = {"task": str(slider_task), "threads": 1}
    plant = {"parameters": {"mass": 1.2}, "noise": 1e-3, **options}
    log, episode, estimate, file = (tmp_path / n for n in ("s.zarr", "n.zarr", "e", "p.json"))
    record(out=log, duration=2, amplitude={"drive": 5}, rate=200, **plant)
    identify(real_log=log, out=estimate, starts=1, quiet=True, **options)
    proposal = propose(result=estimate, threads=1)
    file.write_text(json.dumps(proposal))
    made = record(out=episode, inputs_from=file, **plant).log
    assert made.time.tolist() == proposal["time_s"] and made.episode_ends.tolist() == [len(made.time)]
    assert made.inputs[:, 0].tolist() == proposal["inputs"]["drive"]
    import_log(files=[episode], task=str(slider_task), out=log, append=True)
    with pytest.raises(OptionError, match=r"s\.zarr has 1 new episode since .*e was made from it") as caught:
        diagnose(real_log=log, estimate=estimate, out=tmp_path / "d", quiet=True)
    assert f"capture identify --real-log {log} --out {estimate} --resume" in caught.value.cure
    with pytest.raises(OptionError, match="is not that log as it was then"):
        diagnose(real_log=episode, estimate=estimate, out=tmp_path / "d", quiet=True)
    identify(real_log=log, out=estimate, resume=True, quiet=True, threads=1)
    before, after = proposal["expected_sd"], Estimate.read(estimate).document["parameters"]
    assert Estimate.read(estimate).document["rollouts"]["measured"] == 2
    assert after["mass"]["value"] == pytest.approx(1.2, abs=6 * before["mass"])


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"task": "cart"}, "expected .*'slider', 'inputs'"),
        ({"kind": "action"}, "expected .*'slider', 'inputs'"),
        ({"inputs": [1.0]}, "'inputs' is missing"),
        ({"inputs": {"push": [0.0, 1.0]}}, r"of \(push\), and the task has \(drive\)"),
        ({"inputs": {"drive": ["a", 1.0]}}, "have no values"),
        ({"inputs": {"drive": [0.0]}}, "1 values of each and 2 times"),
        ({"inputs": {"drive": [0.0, None]}}, "not finite"),
        ({"time_s": [0.0, 0.0]}, "does not increase"),
    ],
)
def test_a_file_without_inputs_for_the_task_is_not_recorded(slider_task, tmp_path, other, said):
    proposal = {"format": "capture/proposal", "version": 1, "task": "slider", "kind": "inputs"}
    proposal |= {"time_s": [0.0, 0.01], "inputs": {"drive": [0.0, 1.0]}}
    (tmp_path / "p.json").write_text(json.dumps({**proposal, **other}))
    with pytest.raises(OptionError, match=f"holds no inputs: .*{said}"):
        record(task=str(slider_task), out=tmp_path / "n.zarr", inputs_from=tmp_path / "p.json")
    assert not (tmp_path / "n.zarr").exists()


def test_a_table_is_no_proposal(slider_task, tmp_path):
    (tmp_path / "run.csv").write_text("t_s,u_N\n0,1\n")
    with pytest.raises(OptionError, match="is not JSON") as caught:
        record(task=str(slider_task), out=tmp_path / "n.zarr", inputs_from=tmp_path / "run.csv")
    assert "capture import-log" in caught.value.cure


def test_an_actuator_that_only_pushes_is_not_to_pull(slider_task, tmp_path):
    model = slider_task.parent / "model.xml"
    model.write_text(model.read_text().replace('joint="x"/></act', 'joint="x" ctrlrange="0 5"/></act'))
    options = {"task": str(slider_task), "threads": 1}
    record(out=tmp_path / "s.zarr", duration=4, noise=1e-3, rate=200, **options)
    identify(real_log=tmp_path / "s.zarr", out=tmp_path / "e", starts=1, quiet=True, **options)
    tape = np.array(propose(result=tmp_path / "e", threads=1)["inputs"]["drive"])
    assert tape[0] == tape.min() == 0 < tape.max() <= 5
    with pytest.raises(OptionError, match=r"--amplitude drive=6: .* 0 to 5 N, ends before that"):
        propose(result=tmp_path / "e", amplitude={"drive": 6}, threads=1)


def test_episodes_are_added_to_a_log(scooping, tmp_path):
    log, other = (MeasuredLog.read(scooping / n) for n in ("log.zarr", "other.zarr"))
    import_log(files=[scooping / "log.zarr"], task="scooping", out=tmp_path / "log.zarr")
    both = import_log(
        files=[scooping / "other.zarr"], task="scooping", out=tmp_path / "log.zarr", append=True
    )
    again = MeasuredLog.read(tmp_path / "log.zarr")
    assert np.array_equal(again.outputs, np.concatenate([log.outputs, other.outputs]))
    assert np.array_equal(again.actions, np.concatenate([log.actions, other.actions]))
    assert again.recording.tolist() == [0, 0, 1]
    assert again.recording_names == ("log", "other") == both.recording_names
    with pytest.raises(LogError, match=r"other.zarr is in .*log.zarr already, as the recording 'other'"):
        import_log(files=[scooping / "other.zarr"], task="scooping", out=tmp_path / "log.zarr", append=True)
    record(task="scooping", out=tmp_path / "other.zarr", seed=6, noise=3e-4, threads=1)
    import_log(files=[tmp_path / "other.zarr"], task="scooping", out=tmp_path / "log.zarr", append=True)
    assert MeasuredLog.read(tmp_path / "log.zarr").recording_names == ("log", "other", "other-2")


def test_actions_are_read_from_their_columns(scooping, tmp_path):
    log = MeasuredLog.read(scooping / "other.zarr")
    names = ["time", *log.input_names, *log.output_names, "action.scoop_point"]
    action = np.full((len(log.time), 1), log.actions[0, 0])
    rows = np.concatenate([log.time[:, None], log.inputs, log.outputs, action], axis=1)
    np.savetxt(tmp_path / "run.csv", rows, fmt="%.17g", delimiter=",", header=",".join(names), comments="")
    read = import_log(files=[tmp_path / "run.csv"], task="scooping", out=tmp_path / "log.zarr")
    assert np.array_equal(read.actions, log.actions)
    assert np.array_equal(read.outputs, log.outputs)
    np.savetxt(
        tmp_path / "none.csv",
        rows[:, :-1],
        fmt="%.17g",
        delimiter=",",
        header=",".join(names[:-1]),
        comments="",
    )
    with pytest.raises(LogError, match="has no actions"):
        import_log(files=[tmp_path / "none.csv"], task="scooping", out=tmp_path / "log.zarr", append=True)


@pytest.mark.parametrize(
    ("first", "held", "then", "all_held", "how"),
    [
        ([0] * 8, [6, 7], 2, [6, 7], "end of the first of 2 episodes held out"),
        ([0] * 8, [6, 7], 5, [6, 7, *range(32, 40)], "end of the first and 1 more of 5 episodes held out"),
        ([0] * 8 + [1] * 8, range(8, 16), 3, range(8, 16), "1 of 3 episodes held out: episode 1"),
        (
            [0] * 8 + [1] * 8,
            range(8, 16),
            8,
            [*range(8, 16), *range(56, 64)],
            "2 of 8 episodes held out: episodes 1, 7",
        ),
    ],
)
def test_what_was_held_out_stays_so_as_episodes_come(first, held, then, all_held, how):
    """Windows of 100 samples, eight to an episode."""
    first = np.array(first)
    arrays = {
        "window/first": 100 * np.arange(len(first)),
        "window/is_test": np.isin(np.arange(len(first)), held),
    }
    document = {"rollouts": {"measured": int(first[-1]) + 1}, "split": {"how": ""}}
    earlier = EarlierEstimate(Path("e"), Estimate(document, arrays, {}), {"options": {"test": None}})
    time = np.arange(800 * then) / 128
    log = Log(time, np.zeros((len(time), 1)), slices_until(800 * np.arange(1, then + 1)))
    split = earlier.split(cut(log, 100 / 128, 1 / 128, []), None)
    assert np.flatnonzero(split.is_test).tolist() == list(all_held)
    assert split.how == how


def test_the_end_of_a_single_episode_stays_held_out(slider_task, tmp_path):
    made = {"task": str(slider_task), "duration": 2, "amplitude": {"drive": 5}, "rate": 100, "threads": 1}
    for seed in (0, 1):
        record(out=tmp_path / f"{seed}.zarr", seed=seed, **made)
    options = {"out": tmp_path / "e", "starts": 1, "threads": 1, "quiet": True}
    first = identify(real_log=tmp_path / "0.zarr", task=str(slider_task), **options)
    import_log(files=[tmp_path / "1.zarr"], task=str(slider_task), out=tmp_path / "0.zarr", append=True)
    second = identify(real_log=tmp_path / "0.zarr", resume=True, **options)
    held = [np.flatnonzero(e.arrays["window/is_test"]).tolist() for e in (first, second)]
    assert held[1] == held[0] != []
    assert second.document["error"]["test"] is not None


def test_what_does_not_belong_to_a_log_is_refused_and_the_log_stays(scooping, slider_task, tmp_path):
    import_log(files=[scooping / "log.zarr"], task="scooping", out=tmp_path / "log.zarr")
    before = {f.relative_to(tmp_path): f.read_bytes() for f in tmp_path.rglob("*") if f.is_file()}
    record(
        task=str(slider_task), out=tmp_path.parent / "s.zarr", duration=2, amplitude={"drive": 5}, force=True
    )
    with pytest.raises(LogError, match="belongs to the task 'slider'"):
        import_log(
            files=[tmp_path.parent / "s.zarr"], task="scooping", out=tmp_path / "log.zarr", append=True
        )
    with pytest.raises(OutputError, match="exists already"):
        import_log(files=[scooping / "other.zarr"], task="scooping", out=tmp_path / "log.zarr")
    with pytest.raises(StoreError):
        import_log(files=[scooping / "other.zarr"], task="scooping", out=tmp_path / "no.zarr", append=True)
    after = {f.relative_to(tmp_path): f.read_bytes() for f in tmp_path.rglob("*") if f.is_file()}
    assert {k: v for k, v in after.items() if k in before} == before
    assert not (tmp_path / "no.zarr").exists()


def test_the_online_loop_of_the_docs(tmp_path):
    _run("online_loop.sh", tmp_path / "loop", "1", "scooping", TRUTH="--param com=0.4")
    estimate = Estimate.read(tmp_path / "loop" / "estimate")
    assert estimate.document["rollouts"]["measured"] == 3
    com = estimate.document["parameters"]["com"]
    assert abs(com["value"] - 0.4) < 0.05
    log = MeasuredLog.read(tmp_path / "loop" / "log.zarr")
    proposed = json.loads((tmp_path / "loop" / "proposal-1.json").read_text())
    assert log.actions[-1, 0] == proposed["action"]["scoop_point"]["value"]


def _run(script: str, folder: Path, *arguments: str, **environment: str) -> None:
    with warm_capture("record", "propose", "import_log", undrawn=["identify"]) as capture:
        result = subprocess.run(
            ["bash", str(DOCS / script), str(folder), *arguments],
            env={**os.environ, "CAPTURE": " ".join(capture), **environment},
            capture_output=True,
            text=True,
        )
    assert result.returncode == 0, result.stderr
