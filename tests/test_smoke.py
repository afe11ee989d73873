"""Every command once, on inputs so small that it takes seconds: what to run first after a change."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import mujoco
import pytest
from diagnosing import look_among
from held_inputs import held_machine

from capture_cli.cli.app import _COMMANDS
from capture_cli.log.measured_log import MeasuredLog

pytestmark = pytest.mark.smoke

OF_A_LOG = (
    "record",
    "draft-task",
    "inspect",
    "import-log",
    "identify",
    "diagnose",
    "propose",
    "export",
    "tasks",
    "effects",
)
OF_SIMULATIONS = ("gen-histories", "eval-sim2sim")
OF_TRAINING = ("train-policy", "train-sysid")
TINY = "--width 8 --layers 1 --batch 8 --quiet"


@pytest.fixture
def done(capture):
    """Runs a command that has to succeed: what it wrote to stdout."""

    def run(text: str) -> str:
        code, out, err = capture(*text.split())
        assert code == 0, f"{text}\n{err}"
        return out

    return run


def test_no_command_is_left_out():
    assert {*OF_A_LOG, *OF_SIMULATIONS, *OF_TRAINING} == set(_COMMANDS)


def test_from_a_log_to_a_model(done, tmp_path, monkeypatch):
    """A friction that the model lacks goes from `record` through all that reads a log into the exported model."""
    look_among(monkeypatch, "coulomb-friction", "viscous-damping")
    task = held_machine(tmp_path / "slider", "slider", 0.004)
    plant = "--param mass=1.5 --effect coulomb-friction@x=2 --noise 0.0005 --seed 3 --threads 1"
    done(f"record --task {task} {plant} --episodes 4 --duration 1.5 --rate 250 --out made.zarr --quiet")
    write_csv(MeasuredLog.read(tmp_path / "made.zarr"), tmp_path / "run.csv")
    drafted = json.loads(done(f"draft-task {task.parent}/model.xml --log run.csv --out draft.toml --json"))
    assert drafted["columns"] == {"drive": ["force_N"], "q": ["q_m"]}
    done(f"import-log run.csv --task {task} --out log.zarr --quiet")
    inspected = json.loads(done(f"inspect log.zarr --task {task} --json"))
    assert inspected["kind"] == "measured-log" and len(inspected["recordings"]) == 1
    found = f"--task {task} --starts 1 --threads 1 --json"
    estimate = json.loads(done(f"identify --real-log log.zarr {found} --out estimate"))
    assert estimate["verdict"] == "unexplained"
    diagnosis = json.loads(
        done(f"diagnose --real-log log.zarr --estimate estimate --out diagnosis {found} --no-expression")
    )
    assert (diagnosis["verdict"], [e["name"] for e in diagnosis["effects"]]) == (
        "effect-found",
        ["coulomb-friction"],
    )
    assert all((tmp_path / name / "report.html").is_file() for name in ("estimate", "diagnosis"))
    done(f"propose estimate --task {task} --candidates 2 --threads 1 --out proposal.json --csv proposal.csv")
    done(f"record --task {task} {plant} --inputs-from proposal.json --out next.zarr --quiet")
    assert (
        MeasuredLog.read(tmp_path / "next.zarr").time.tolist()
        == json.loads((tmp_path / "proposal.json").read_text())["time_s"]
    )
    done("export diagnosis --out identified.xml --json")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "identified.xml"))
    assert model.body("carriage").mass[0] == pytest.approx(1.5, rel=0.05)
    assert model.joint("x").frictionloss[0] == pytest.approx(2.0, rel=0.05)
    assert "coulomb-friction" in done(f"effects --task {task}")
    assert "mass" in done(f"tasks --task {task}")


def write_csv(log: MeasuredLog, path: Path) -> None:
    """The log as a logger writes it."""
    episodes = [number for number, steps in enumerate(log.episodes) for _ in log.time[steps]]
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["t_s", "force_N", "q_m", "episode"])
        rows.writerows(zip(log.time, log.inputs[:, 0], log.outputs[:, 0], episodes, strict=True))


def test_from_simulations_to_an_evaluation(done):
    done("gen-histories --task scooping --pairs 8 --rounds 2 --threads 1 --out histories.zarr --quiet")
    evaluated = "--identifier domain-randomization --pairs 2 --seeds 1 --rounds 2 --threads 1"
    document = json.loads(done(f"eval-sim2sim --task scooping {evaluated} --out evaluation --json"))
    assert list(document["identifiers"]) == ["domain-randomization"]


def test_from_simulations_to_an_identifier(done, learn):
    done(f"train-policy --task scooping --steps 64 --evaluations 1 --out policy {TINY}")
    done(
        "gen-histories --task scooping --policy policy --pairs 16 --rounds 3 --threads 1 --out h.zarr --quiet"
    )
    done(f"train-sysid --histories h.zarr --identifier posterior --heads 2 --steps 2 --out identifier {TINY}")
    done(
        "record --task scooping --policy policy --episodes 3 --noise 0.0003 --threads 1 --out log.zarr --quiet"
    )
    found = done("identify --real-log log.zarr --identifier identifier --threads 1 --out estimate --json")
    assert json.loads(found)["identifier"] == "posterior"
