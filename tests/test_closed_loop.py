"""docs/closed_loop.sh, tiny: what is found on a machine goes back into the simulator, and estimates are right there."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest
import typer
from warm_capture import DRAWS, warm_capture

from capture_cli.cli.app import app
from capture_cli.context.checkpoints.policy_checkpoint import read_policy
from capture_cli.store.diagnosis import Diagnosis
from capture_cli.store.estimate import Estimate
from capture_cli.store.evaluation import Evaluation

SCRIPT = Path(__file__).resolve().parents[1] / "docs" / "closed_loop.sh"
STAGES = ("train_policy", "gen_histories", "train_sysid", "record", "identify", "diagnose", "eval_sim2sim")
MISSING = "control-bias@spatula_x"
AMONG = ("control-bias", "control-gain", "control-delay", "coulomb-friction", "sensor-bias", "sensor-scale")


def loop(*arguments: str | Path, capture: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["bash", str(SCRIPT), *map(str, arguments)],
        env={**os.environ, "CAPTURE": capture},
        capture_output=True,
        text=True,
        check=False,
    )


def last(folder: Path, name: str) -> list[float]:
    """After the last round, of the one identifier of an evaluation."""
    [entry] = Evaluation.read(folder).document["identifiers"].values()
    return {"error": entry["parameter_difference"]["mean"], "success": entry["success"]}[name][-1]


def test_the_loop_closes_through_the_policy(tmp_path, learn):
    folder = tmp_path / "loop"
    with warm_capture(*STAGES, undrawn=list(DRAWS), among=AMONG) as capture:
        done = loop(folder, "tiny", capture=" ".join(capture))
    assert done.returncode == 0, done.stderr
    truth = json.loads((folder / "log.truth.json").read_text())
    # the declared model leaves the log unexplained, and the diagnosis says what it lacks
    before = Estimate.read(folder / "declared" / "estimate").document
    assert before["verdict"] == "unexplained" and before["effects"] == []
    found = Diagnosis.read(folder / "diagnosis").document
    assert [f"{e['name']}@{e['site']}" for e in found["effects"]] == [MISSING]
    offset = found["effects"][0]["parameters"]["offset"]["value"]
    assert abs(offset - truth["effects"][f"{MISSING}.offset"]) < 5e-4
    # with it the log is explained, and the parameter is found
    after = Estimate.read(folder / "mended" / "estimate").document
    assert after["effects"][0]["parameters"]["offset"]["value"] == offset
    assert abs(after["parameters"]["com"]["value"] - truth["parameters"]["com"]) < 0.05
    assert after["error"]["fit"]["normalized"] < 0.2 * before["error"]["fit"]["normalized"]
    assert read_policy(folder / "mended" / "policy")["effects"][0]["name"] == "control-bias"
    # on machines like it estimates are off by the 8 mm, in a range of 160, before, and right after
    error, success = (
        {name: last(folder / name / "evaluation", what) for name in ("declared", "mended")}
        for what in ("error", "success")
    )
    assert abs(error["declared"] - 0.05) < 0.02 and error["mended"] < 0.5 * error["declared"]
    assert all(0 <= share <= 1 for share in success.values())
    # what is there is not made again
    assert loop(folder, "tiny", capture="false").returncode == 0


@pytest.mark.parametrize("size", ["full", "door"])
def test_the_robot_plays_the_machines_of_the_large_sizes(tmp_path, size):
    done = loop(tmp_path / "loop", size, "UR5e", capture="echo capture")
    assert (done.returncode, done.stderr) == (0, "")
    lines = [line.split()[1:] for line in done.stdout.splitlines() if line.startswith("capture")]
    commands = typer.main.get_command(app).commands
    for name, *options in lines:
        known = {
            o for parameter in commands[name].params for o in (*parameter.opts, *parameter.secondary_opts)
        }
        assert {option for option in options if option.startswith("--")} <= known
    assert [name for name, *options in lines if "UR5e" in options] == ["record", *["eval-sim2sim"] * 2]
    mended = [name for name, *options in lines if "--estimate diagnosis" in " ".join(options)]
    assert mended == ["train-policy", "gen-histories"]


def test_a_size_that_is_none_is_refused(tmp_path):
    done = loop(tmp_path / "loop", "small", capture="false")
    assert (done.returncode, done.stderr) == (2, "small: tiny, full or door\n")
