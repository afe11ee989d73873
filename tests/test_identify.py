"""Plant parameters, record a log, identify: what comes back, what is said about it, and what is refused."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from held_inputs import hold

from capture_cli.context.identifiers import REGISTRY
from capture_cli.errors import FitError, LogError, OptionError
from capture_cli.estimate.solve.least_squares import LeastSquares
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.report import diagnosis_findings, findings
from capture_cli.stages import diagnose as diagnose_stage
from capture_cli.stages import identify as stage
from capture_cli.stages.documents.agreement import agreement
from capture_cli.stages.documents.estimate_document import Report
from capture_cli.stages.identification.chosen_identifier import ChosenIdentifier
from capture_cli.stages.record import record
from capture_cli.store.diagnosis import DiagnosisRecord
from capture_cli.store.estimate import Estimate, EstimateRecord
from capture_cli.store.output import sha256

MACHINES = Path(__file__).resolve().parents[1] / "benchmarks" / "machines"
SLIDER = MACHINES / "slider" / "task.toml"
TRUTH = {"mass": 1.4, "damping": 9.0, "stiffness": 110.0}


@pytest.fixture(autouse=True)
def without_pages(monkeypatch):
    """Reports have tests of their own."""
    monkeypatch.setattr(stage, "_write_pages", lambda *_: None)


@pytest.fixture
def plant(tmp_path):
    """Records a log of a task, by default the slider at TRUTH: 2 episodes of 1.5 s at 250 Hz."""

    def plant(task: Path = SLIDER, name: str = "log", **options) -> MeasuredLog:
        defaults = {"parameters": TRUTH, "noise": 5e-4, "episodes": 2, "duration": 1.5, "rate": 250.0}
        made = record(
            task=str(task), out=tmp_path / f"{name}.zarr", **{**defaults, "threads": 1, **options}
        ).log
        return replace(made, path=tmp_path / f"{name}.zarr")

    return plant


@pytest.fixture
def identify(tmp_path):
    """Identifies from a log, which is written first if it was changed in memory; one descent, one thread."""

    def identify(log: MeasuredLog, task: Path = SLIDER, **options) -> Estimate:
        path = log.path
        if path is None:
            path = tmp_path / "changed.zarr"
            log.write(path)
        options = {"starts": 1, "threads": 1, "quiet": True, "test": "none", **options}
        out = options.pop("out", tmp_path / "estimate")
        return stage.identify(real_log=path, task=str(task), out=out, force=True, **options)

    return identify


def changed(log: MeasuredLog, **fields) -> MeasuredLog:
    return replace(log, path=None, **fields)


def join(*logs: MeasuredLog) -> MeasuredLog:
    """One log with each of `logs` as a recording."""
    steps = np.cumsum([0, *(len(log.time) for log in logs[:-1])])
    first = logs[0]
    return changed(
        first,
        time=np.concatenate([log.time for log in logs]),
        inputs=np.concatenate([log.inputs for log in logs]),
        outputs=np.concatenate([log.outputs for log in logs]),
        episode_ends=np.concatenate([log.episode_ends + s for log, s in zip(logs, steps, strict=True)]),
        recording=np.concatenate([np.full(len(log.episode_ends), i) for i, log in enumerate(logs)]),
        recordings=tuple(
            {"name": f"run{i}", "source": "test", "sha256": None} for i, _ in enumerate(logs, start=1)
        ),
    )


def variant(tmp_path: Path, text: str, *replacements: tuple[str, str]) -> Path:
    """A task.toml of the slider's model with `text` as its parameters."""
    task = SLIDER.read_text()
    task = task[: task.index("[parameters")] + text + task[task.index("[inputs") :]
    for old, new in replacements:
        assert old in task
        task = task.replace(old, new)
    folder = tmp_path / "variant"
    folder.mkdir()
    (folder / "model.xml").write_text((MACHINES / "slider" / "model.xml").read_text())
    (folder / "task.toml").write_text(task)
    return folder / "task.toml"


def parameter(name: str, targets: str, low: float, high: float) -> str:
    return f'[parameters.{name}]\nset = "{targets}"\nlow = {low}\nhigh = {high}\nunit = "SI"\n\n'


MASS = parameter("mass", "body:carriage:mass", 1.0, 4.0)
DAMPING = parameter("damping", "joint:x:damping", 0.0, 15.0)


def errors_in(found: Estimate, truth: dict[str, float], unit: str) -> np.ndarray:
    """Estimate minus truth of each parameter, over its range ("range") or over its standard deviation ("sd")."""
    rows = [(truth[name], p) for name, p in found.document["parameters"].items()]
    scale = {"range": lambda p: p["high"] - p["low"], "sd": lambda p: p["sd"]}[unit]
    return np.array([(p["value"] - true) / scale(p) for true, p in rows])


GRIPPER = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <default><geom type="capsule" fromto="0 0 0 .1 0 0" size=".01" mass=".1" contype="0"/></default>
  <worldbody>
    <body name="a"><joint name="a" axis="0 0 1" damping="0.02" armature="0.001"/><geom/></body>
    <body name="b" pos="0 -.1 0"><joint name="b" axis="0 0 -1" damping="0.02" armature="0.001"/><geom/></body>
  </worldbody>
  <equality><joint joint1="b" joint2="a"/></equality>
  <actuator><motor name="m" joint="a" ctrlrange="-0.5 0.5"/></actuator>
  <sensor><jointpos name="a" joint="a"/><jointpos name="b" joint="b"/></sensor>
</mujoco>
"""


@pytest.mark.parametrize("measured", ["a", "ab"])
def test_light_joints_that_a_soft_constraint_couples(plant, identify, tmp_path, measured):
    """Their motor would accelerate them by hundreds of rad/s^2: the constraint gives way by far more than the noise."""
    (tmp_path / "model.xml").write_text(GRIPPER)
    task = tmp_path / "task.toml"
    task.write_text(
        'format = 1\nname = "gripper"\nmodel = "model.xml"\n[log]\nwindow = 0.2\n'
        + parameter("damping", "joint:a:damping", 0.005, 0.1)
        + parameter("armature", "joint:a:armature", 0.0002, 0.005)
        + '[inputs.m]\ncolumn = "m"\nunit = "N m"\n'
        + "".join(f'[outputs.{name}]\ncolumn = "{name}"\nunit = "rad"\n' for name in measured)
    )
    truth = {"damping": 0.03, "armature": 0.002}
    found = identify(plant(task, parameters=truth, noise=1e-4, episodes=1, rate=200.0), task)
    assert found.document["verdict"] == "explained"
    assert np.abs(errors_in(found, truth, "sd")).max() < 4


# --- what is said of an estimate ---


@pytest.mark.parametrize("truth", [0.0143, 0.02])
def test_inertia_that_no_body_has_is_noted(plant, identify, tmp_path, truth):
    (tmp_path / "model.xml").write_text("""
        <mujoco>
          <worldbody>
            <body name="rod">
              <joint name="yaw" axis="0 0 1" damping=".05"/>
              <geom type="capsule" fromto="-.2 0 0 .2 0 0" size=".01" mass="1"/>
            </body>
          </worldbody>
          <actuator><motor name="m" joint="yaw" ctrlrange="-1 1"/></actuator>
          <sensor><jointpos name="q" joint="yaw"/></sensor>
        </mujoco>""")
    task = tmp_path / "task.toml"
    task.write_text(
        'format = 1\nname = "rod"\nmodel = "model.xml"\n'
        + parameter("I", "body:rod:inertia_x", 0.001, 0.1)
        + '[inputs.m]\ncolumn = "m"\nunit = "N m"\n[outputs.q]\ncolumn = "q"\nunit = "rad"\n'
    )
    found = identify(plant(task, parameters={"I": truth}), task)
    assert found.document["verdict"] == "explained"
    notes = findings.notes(found.record)
    if truth < 0.01432:  # the others together
        assert found.document["impossible_inertia"] == [] == notes
    else:
        (item,) = found.document["impossible_inertia"]
        assert item["body"] == "rod" and item["moments"][2] == pytest.approx(truth, rel=0.01)
        assert notes == [item["text"]] and "rod" in notes[0] and "body:rod:inertia, a factor" in notes[0]


# --- plant and recover ---


@pytest.mark.parametrize(("machine", "noise"), [("slider", 0.0), ("cart_pole", 5e-4), ("arm", 5e-4)])
def test_recovers_what_was_planted(plant, identify, machine, noise):
    task = MACHINES / machine / "task.toml"
    log = plant(task, parameters={}, random_parameters=True, noise=noise, seed=7)
    truth = json.loads(log.path.with_suffix(".truth.json").read_text())["parameters"]
    found = identify(log, task, starts=2)
    assert found.document["verdict"] == "explained"
    assert all(p["identifiable"] and not p["at_bound"] for p in found.document["parameters"].values())
    assert np.abs(errors_in(found, truth, "range")).max() < (1e-3 if noise == 0 else 0.02)
    assert np.abs(errors_in(found, truth, "sd")).max() < 4
    assert found.document["error"]["fit"]["normalized"] < 1.1
    for name, p in found.document["parameters"].items():
        assert p["low"] <= p["ci95"][0] <= p["value"] <= p["ci95"][1] <= p["high"], name


def test_cma_es_recovers_it_too(plant, identify):
    found = identify(plant(duration=1.0), identifier="cma-es", rounds=50)
    assert found.document["identifier"] == "cma-es"
    assert np.abs(errors_in(found, TRUTH, "sd")).max() < 5
    assert found.document["verdict"] == "explained"


def test_what_a_filtered_actuator_is_at_when_a_window_begins_is_known(plant, identify, tmp_path):
    """However large the control's numbers are: an activation is in their unit."""
    task = variant(tmp_path, MASS + DAMPING)
    model = task.with_name("model.xml")
    motor = '<motor name="drive" joint="x" ctrlrange="-30 30"/>'
    filtered = motor.replace("motor", "general").replace("-30 30", "-3e4 3e4")
    filtered = filtered.replace("/>", ' gainprm="1e-3" dyntype="filterexact" dynprm=".05"/>')
    assert motor in model.read_text()
    model.write_text(model.read_text().replace(motor, filtered))
    truth = {name: TRUTH[name] for name in ("mass", "damping")}
    found = identify(plant(task, parameters=truth), task)
    assert found.document["verdict"] == "explained"
    assert np.abs(errors_in(found, truth, "sd")).max() < 4
    assert found.document["error"]["fit"]["normalized"] < 1.05


def test_uneven_sampling(plant, identify):
    even = plant(duration=1.5, rate=200.0)
    jitter = np.random.default_rng(0).uniform(-0.45, 0.45, len(even.time)) / 200
    jitter[[0, *even.episode_ends[:-1]]] = 0
    uneven = changed(even, time=even.time + jitter)
    uneven.write(even.path.parent / "uneven.zarr")
    as_logged = {"episodes": 1, "duration": None, "rate": None}
    log = plant(name="again", inputs_from=even.path.parent / "uneven.zarr", **as_logged)
    assert np.ptp(np.diff(log.time[: log.episode_ends[0]])) > 4e-3
    found = identify(log)
    assert found.document["verdict"] == "explained"
    assert np.abs(errors_in(found, TRUTH, "sd")).max() < 4


def test_a_clock_that_does_not_begin_at_zero(plant, identify):
    log = plant()
    later = identify(changed(log, time=log.time + 1e5))
    assert np.abs(errors_in(later, TRUTH, "sd")).max() < 4


def test_a_task_without_inputs(plant, identify):
    task = MACHINES / "puck" / "task.toml"
    log = plant(
        task,
        parameters={"friction": 0.17},
        start_velocity={"x": (0.3, 1.0), "y": (-0.5, 0.5)},
        duration=0.5,
        noise=2e-4,
    )
    assert log.inputs.shape[1] == 0
    found = identify(log, task)
    assert np.abs(errors_in(found, {"friction": 0.17}, "sd")).max() < 4


def test_an_empty_list_of_parameters(plant, identify, tmp_path):
    task = variant(tmp_path, "")
    found = identify(plant(task, parameters={}), task)
    assert found.document["parameters"] == {}
    assert found.document["verdict"] == "explained"
    wrong = identify(plant(name="stiffer", parameters={"stiffness": 80.0}), task)
    assert wrong.document["verdict"] == "unexplained"


def test_noisy_starts_are_refined(plant, identify):
    """Windows so short that a start off by its noise would be most of the error."""
    log = plant(noise=3e-3, duration=2.0)
    found = identify(log, window=0.2)
    assert found.document["verdict"] == "explained"
    assert found.document["error"]["fit"]["normalized"] < 1.05
    assert np.abs(found.arrays["window/start_offset"]).max() > 1e-3
    assert np.abs(errors_in(found, TRUTH, "sd")).max() < 4


def test_trials_that_diverge_are_bad_points_only(plant, identify, tmp_path):
    task = variant(tmp_path, MASS + parameter("damping", "joint:x:damping", -20000.0, 15.0))
    log = plant(task, parameters={"mass": 1.4, "damping": 9.0})
    found = identify(log, task, starts=3)
    assert np.abs(errors_in(found, {"mass": 1.4, "damping": 9.0}, "sd")).max() < 4
    assert found.document["verdict"] == "explained"


def test_when_every_trial_diverges_that_is_said(plant, identify, tmp_path):
    task = variant(tmp_path, parameter("damping", "joint:x:damping", -30000.0, -20000.0))
    with pytest.raises(FitError, match="diverged") as caught:
        identify(plant(), task)
    assert "bounds" in caught.value.cure
    assert not (tmp_path / "estimate").exists()


# --- the same again ---


def test_the_same_bytes_for_any_threads_and_any_run(plant, identify, tmp_path):
    log = plant(noise=1e-3)
    hashes = set()
    for run, threads in enumerate((1, 2, 1)):
        out = tmp_path / f"run{run}"
        identify(log, starts=2, threads=threads, test=None, out=out)
        hashes.add(sha256(out / "estimate.zarr"))
    assert len(hashes) == 1


# --- what is said ---


def test_a_joint_that_nobody_measures_is_named_where_something_is_left(plant, identify, tmp_path):
    machine = MACHINES / "cart_pole"
    (tmp_path / "model.xml").write_text((machine / "model.xml").read_text())
    text = (machine / "task.toml").read_text()
    (tmp_path / "task.toml").write_text(text[: text.index("[outputs.pole]")])
    log = plant(tmp_path / "task.toml", parameters={}, start={"theta": (2.0, 2.5)})
    found = identify(log, tmp_path / "task.toml", rounds=5)
    assert found.document["unmeasured_joints"] == ["theta"]
    assert found.document["verdict"] == "unexplained"
    assert any("position of theta" in note for note in findings.notes(found.record))
    assert identify(plant(name="all")).document["unmeasured_joints"] == []


@pytest.fixture
def coarse(tmp_path) -> Path:
    """The slider in steps of 20 ms, in which its integrator takes some of the damping away."""
    task = variant(tmp_path, MASS + DAMPING)
    model = task.parent / "model.xml"
    assert 'timestep="0.002"' in model.read_text()
    model.write_text(model.read_text().replace('timestep="0.002"', 'timestep="0.02"'))
    return task


def test_where_a_shorter_time_step_would_put_the_parameters_is_said(plant, identify, coarse):
    truth = {"mass": 1.4, "damping": 9.0}
    log = plant(coarse, parameters=truth, effects=["finer-time-step@quarter"], rate=50.0, episodes=4)
    found = identify(log, coarse).document
    assert found["parameters"]["damping"]["value"] < 8.7
    assert found["time_step"]["finer"] == 0.005
    assert found["time_step"]["parameters"]["damping"] == pytest.approx(9.0, rel=0.01)
    assert any(
        "in steps of 5 ms, and not 20, damping would be about 9.01" in note
        for note in findings.notes(EstimateRecord.of(found))
    )


def test_a_log_that_was_simulated_in_the_models_own_steps_is_not_said_to_be_otherwise(
    plant, identify, coarse
):
    truth = {"mass": 1.4, "damping": 9.0}
    found = identify(plant(coarse, parameters=truth, rate=50.0, episodes=4), coarse).document
    assert found["parameters"]["mass"]["value"] == pytest.approx(
        1.4, abs=4 * found["parameters"]["mass"]["sd"]
    )
    assert found["time_step"] is None


def test_where_stops_are_hit_the_windows_count_that_a_shorter_step_explains_as_well(plant, identify, coarse):
    model = coarse.parent / "model.xml"
    stops = '<joint name="x" limited="true" range="-0.06 0.06" solreflimit="0.06 0.7"'
    model.write_text(model.read_text().replace('<joint name="x"', stops))
    options = {"parameters": {"mass": 1.4, "damping": 9.0}, "rate": 50.0, "episodes": 6}
    found = identify(
        plant(coarse, name="real", effects=["finer-time-step@quarter"], **options), coarse
    ).document
    here, there = found["parameters"]["mass"]["value"], found["time_step"]["parameters"]["mass"]
    assert here - 1.4 > 0.1
    assert abs(there - 1.4) < (here - 1.4) / 4
    assert identify(plant(coarse, name="own", **options), coarse).document["time_step"] is None


def test_where_a_shorter_time_step_would_put_what_is_beside_an_effect_is_said(
    plant, coarse, tmp_path, monkeypatch
):
    monkeypatch.setattr(diagnose_stage, "_write_pages", lambda *_: None)
    hold(coarse, 0.02)
    log = plant(
        coarse,
        parameters={"mass": 1.4, "damping": 9.0},
        effects=["constant-force@x=3.0", "finer-time-step@quarter"],
        noise=6e-3,
        rate=50.0,
        episodes=4,
    )
    found = diagnose_stage.diagnose(
        real_log=log.path, out=tmp_path / "diagnosis", task=str(coarse), threads=1, quiet=True
    ).document
    assert len(found["effects"]) == 1
    value, sd = (found["parameters"]["damping"][key] for key in ("value", "sd"))
    assert 9.0 - value > 4 * sd
    assert found["time_step"]["parameters"]["damping"] == pytest.approx(9.0, abs=3 * sd)
    assert found["time_step"]["text"] in diagnosis_findings.notes(DiagnosisRecord.of(found))


def test_an_effect_that_is_not_declared_is_unexplained(plant, identify, tmp_path):
    log, out = plant(name="of today", effects=["coulomb-friction@x=3.0"]), tmp_path / "an estimate"
    found = identify(log, out=out)
    assert found.document["verdict"] == "unexplained"
    command = ["capture", "diagnose", "--real-log", str(log.path), "--estimate"]
    assert shlex.split(findings.next_command(found.record, str(out))) == [*command, str(out)]
    again = identify(log, out=tmp_path / "another")
    assert shlex.split(again.document["next_command"]) == [*command, "ESTIMATE"]
    assert again.document == found.document, "whatever it is called"
    assert found.document["error"]["fit"]["normalized"] > 5
    assert "The model lacks something" in found.document["summary"]


def test_only_a_sum_is_determined(plant, identify, tmp_path):
    """Damping of the joint and of its drive act alike."""
    both = MASS + DAMPING + parameter("back_emf", "actuator:drive:bias_velocity", -15.0, 0.0)
    task = variant(tmp_path, both)
    found = identify(plant(task, parameters={"mass": 2.0, "damping": 4.0, "back_emf": -3.0}), task)
    document = found.document
    assert document["verdict"] == "not-identifiable"
    assert [p["identifiable"] for p in document["parameters"].values()] == [True, False, False]
    (open_,) = document["undetermined"]
    assert set(open_["combination"]) == {"damping", "back_emf"}
    assert open_["combination"]["damping"] * open_["combination"]["back_emf"] == pytest.approx(1, abs=0.01)
    assert "damping" in document["summary"]
    assert "back_emf" in document["summary"]
    damping, back_emf = document["parameters"]["damping"], document["parameters"]["back_emf"]
    assert damping["value"] - back_emf["value"] == pytest.approx(7.0, abs=0.1)
    # neither brakes less than not at all
    assert damping["limits"] == {"at_least": None, "at_most": pytest.approx(7.0, abs=0.15)}
    assert back_emf["limits"] == {"at_least": pytest.approx(-7.0, abs=0.15), "at_most": None}


@pytest.mark.parametrize("noise", [0.0, 5e-4])
def test_only_a_product_is_determined(plant, identify, tmp_path, noise):
    pair = parameter("gain", "actuator:drive:gain", 0.5, 2.0) + parameter(
        "gear", "actuator:drive:gear", 0.2, 9.0
    )
    task = variant(tmp_path, MASS + pair)
    found = identify(plant(task, parameters={"mass": 2.0, "gain": 0.6, "gear": 1.8}, noise=noise), task)
    assert found.document["verdict"] == "not-identifiable"
    values = {name: p["value"] for name, p in found.document["parameters"].items()}
    assert values["gain"] * values["gear"] == pytest.approx(1.08, rel=0.01)
    assert [set(u["combination"]) for u in found.document["undetermined"]] == [{"gain", "gear"}]
    # any gain will do, and with it the gears from 1.08 / 2.0 to 1.08 / 0.5
    gain, gear = found.document["parameters"]["gain"], found.document["parameters"]["gear"]
    assert (gain["limits"], gain["ci95"]) == (None, [0.5, 2.0])
    assert gear["ci95"] == list(gear["limits"].values()) == pytest.approx([0.54, 2.16], abs=0.09)
    assert "determine gain, gear (between" in found.document["summary"]


def test_a_parameter_that_moves_nothing_is_named(plant, identify, tmp_path):
    task = variant(tmp_path, MASS + parameter("idle", "geom:block:friction", 0.1, 1.0))
    with pytest.raises(FitError, match="idle moves no output") as caught:
        identify(plant(), task)
    assert "mass" not in caught.value.message
    assert not (tmp_path / "estimate").exists()


def test_that_is_said_before_any_work_whoever_identifies(plant, identify, tmp_path, monkeypatch):
    task = variant(tmp_path, MASS + parameter("idle", "geom:block:friction", 0.1, 1.0))
    log, checkpoint = plant(), tmp_path / "checkpoint"
    checkpoint.mkdir()
    of_no_effects = Mock(machine=lambda machine: machine)
    learned = ChosenIdentifier("learned", LeastSquares, checkpoint=of_no_effects, path=checkpoint)
    monkeypatch.setattr(stage, "with_noise_of_repeats", lambda *_, **__: pytest.fail("worked before"))
    for chosen in (learned, replace(learned, checkpoint=None)):
        monkeypatch.setattr(stage, "choose_identifier", lambda *_, chosen=chosen: chosen)
        with pytest.raises(FitError, match="idle moves no output"):
            identify(log, task)


def test_a_parameter_at_its_bound_is_said(plant, identify):
    found = identify(plant(parameters={**TRUTH, "mass": 5.0}))
    mass = found.document["parameters"]["mass"]
    assert (mass["at_bound"], mass["value"]) == (True, 4.0)
    assert mass["ci95"][1] == 4.0


def test_bounds_that_are_far_too_wide_are_warned_of(plant, identify, tmp_path, capsys):
    task = variant(tmp_path, MASS.replace("high = 4.0", "high = 1e4"))
    mass = identify(plant(parameters={"mass": 1.4}), task).document["parameters"]["mass"]
    assert mass["value"] == pytest.approx(1.4, abs=0.01)  # 4e-5 of the range from the bound
    assert not mass["at_bound"]
    err = capsys.readouterr().err
    assert err.count("warning:") == 1
    assert "parameter mass: its bounds, 1 to 10000 SI, span 5000 times its nominal value" in err
    assert "cure: give [parameters.mass] bounds" in err


def test_autocorrelated_noise_widens_the_intervals(plant, identify):
    """Against the same amount of white noise: first-order autoregressive with coefficient 0.9."""
    clean = plant(noise=0.0, duration=3.0)
    white = np.random.default_rng(1).standard_normal(clean.outputs.shape)
    drifting = np.zeros_like(white)
    for step in range(1, len(white)):
        drifting[step] = 0.9 * drifting[step - 1] + np.sqrt(1 - 0.9**2) * white[step]
    sd = []
    for noise in (white, drifting):
        found = identify(changed(clean, outputs=clean.outputs + 1e-3 * noise))
        sd.append([p["sd"] for p in found.document["parameters"].values()])
        assert np.abs(errors_in(found, TRUTH, "sd")).max() < 4
    assert (np.array(sd[1]) > 1.5 * np.array(sd[0])).all()


def test_a_search_that_was_cut_short_says_so_first(plant, identify):
    log = plant()
    found = identify(log, rounds=2)
    assert found.document["cut_short"] == 2
    assert "after --rounds 2, before it came to rest" in findings.notes(found.record)[0]
    assert findings.UNTRUSTED not in findings.notes(found.record)
    assert "The model lacks" not in found.document["summary"]
    assert found.document["next_command"] is None
    assert identify(log).document["cut_short"] is None


def test_one_round_ends_somewhere_whatever_the_places_it_begins_at(plant, identify):
    log = plant()
    assert identify(log, rounds=1, starts=3).document["cut_short"] == 1


def test_rounds_and_rollouts_are_reported(plant, identify):
    found = identify(plant(), rounds=2)
    assert len(found.document["rounds"]) == 2
    assert found.document["rounds"][0]["error"] >= found.document["rounds"][1]["error"]
    assert found.document["rollouts"]["measured"] == 2
    assert found.document["rollouts"]["simulated"] > 0


# --- several recordings ---


def test_recordings_that_agree(plant, identify):
    found = identify(join(plant(name="a"), plant(name="b", seed=1)))
    said = found.document["recordings"]
    assert (said["agree"], said["names"]) == (True, ["run1", "run2"])
    for name, each in said["parameters"].items():
        assert np.abs((np.array(each["values"]) - TRUTH[name]) / each["sd"]).max() < 4
    assert found.arrays["parameter/recordings"].shape == (2, 3)


def test_recordings_that_disagree(plant, identify):
    heavier = {**TRUTH, "mass": 1.5}
    found = identify(join(plant(name="a"), plant(name="b", seed=1, parameters=heavier)))
    said = found.document["recordings"]
    assert not said["agree"]
    assert "mass" in said["text"]
    assert said["parameters"]["mass"]["values"] == pytest.approx([1.4, 1.5], abs=0.01)
    assert re.search(r"most about mass \(spread 6\.\d % of its value, p = ", said["text"])


@pytest.mark.parametrize(
    ("values", "low", "said"),
    [
        ((0.3500, 0.3501), 0.0, None),  # 0.03 %: told apart, and of no use
        ((0.3500, 0.3600), 0.0, r"spread 2\.8 % of its value"),
        ((1e-4, 3e-4), 0.0, None),  # as good as 0
        ((1e-4, 3e-4), 5e-5, r"spread 100 % of its value"),  # cannot be 0
        ((-0.2, 0.2), -1.0, r"spread 20 % of its bounds' span"),
    ],
)
def test_recordings_disagree_by_what_matters(values, low, said):
    space = ParameterSpace([Parameter("friction", "N m", low, 1.0, 0.5)])
    sd = np.full((2, 1), 1e-6)
    found = agreement(["a", "b"], np.array(values)[:, None], sd, 1e4, space, np.array([True]))
    assert found.p_values[0] < 1e-9
    assert found.agree is (said is None)
    assert said is None or re.search(said, found.text)


@pytest.mark.parametrize(
    ("test", "held"), [("run2", [1]), ("run[13]", [0, 2]), ("run1, run3", [0, 2]), ("*2", [1]), ("none", [])]
)
def test_recordings_are_held_out_by_pattern(plant, identify, test, held):
    log = join(*(plant(name=str(i), seed=i, episodes=1, duration=0.6) for i in range(3)))
    found = identify(log, test=test, rounds=1)
    is_test = found.arrays["window/is_test"]
    recording = np.asarray(log.recording)[found.arrays["window/episode"]]
    np.testing.assert_array_equal(is_test, np.isin(recording, held))
    assert (found.document["error"]["test"] is None) == (test == "none")


@pytest.mark.parametrize(("test", "named"), [("run7", "run1, run2"), ("run*", "at least one")])
def test_patterns_that_hold_out_nothing_or_everything(plant, identify, test, named):
    with pytest.raises(OptionError) as caught:
        identify(join(plant(name="a"), plant(name="b")), test=test)
    assert f"--test {test!r}" in caught.value.message
    assert named in str(caught.value)


def test_a_share_is_held_out_by_default(plant, identify):
    found = identify(plant(episodes=4), test=None)
    assert found.document["split"] == {
        "how": "1 of 4 episodes held out: episode 3",
        "fit_windows": 9,
        "test_windows": 3,
    }
    assert found.document["error"]["test"]["normalized"] < 1.3


# --- logs that cannot be used ---


@pytest.mark.parametrize(
    ("options", "cut_to", "named"),
    [
        ({}, 0.3, "window"),  # s, shorter than a window
        ({"window": 0.02}, 0.024, "8 samples"),
        ({"window": 0.008}, 1.0, "fewer than 4 samples"),
        ({"window": 1.0, "test": None}, 1.0, "hold any back"),
    ],
)
def test_a_log_that_is_too_short(plant, identify, options, cut_to, named):
    log = plant(episodes=1, duration=cut_to)
    with pytest.raises(LogError, match=named) as caught:
        identify(log, **options)
    assert caught.value.cure


@pytest.mark.parametrize("window", [0.0, -0.5, np.nan, np.inf])
def test_a_window_that_is_no_duration(plant, identify, window):
    with pytest.raises(OptionError, match="--window"):
        identify(plant(), window=window)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("where", ["outputs", "inputs"])
def test_values_that_are_not_finite(plant, identify, bad, where):
    log = plant()
    values = getattr(log, where).copy()
    values[17] = bad
    with pytest.raises(LogError, match="at step 17"):
        identify(changed(log, **{where: values}))


def test_a_log_of_another_task(plant, identify):
    log = plant(MACHINES / "puck" / "task.toml", parameters={}, start_velocity={"x": (1.0, 1.0)})
    with pytest.raises(LogError) as caught:
        identify(log)
    assert "(x, y)" in caught.value.message or "()" in caught.value.message
    assert "'slider'" in caught.value.message


def test_what_is_not_an_identifier(plant, identify):
    with pytest.raises(OptionError) as caught:
        identify(plant(), identifier="least-sqares")
    assert (
        "did you mean 'least-squares'? There are: cma-es, least-squares; or give a dir" in caught.value.cure
    )


@pytest.mark.parametrize("given", ["foo", "compass"])
def test_the_identifiers_that_a_cure_names_work_there(given, plant, identify):
    with pytest.raises(OptionError) as caught:
        identify(plant(), identifier=given)
    names, others = caught.value.cure.partition(";")[0], set(REGISTRY.names()) - {"cma-es", "least-squares"}
    assert "cma-es" in names and not any(name in names for name in others)


def test_windows_in_which_the_simulation_runs_away_are_counted_and_explain_nothing(
    plant, identify, monkeypatch
):
    log = plant()
    sound = identify(log).document
    assert (sound["verdict"], sound["diverged_windows"]) == ("explained", 0)
    curves = Report._curves

    def one_runs_away(self, corrections):
        simulated, nominal, diverged = curves(self, corrections)
        return simulated, nominal, diverged | (np.arange(len(diverged)) == 1)

    monkeypatch.setattr(Report, "_curves", one_runs_away)
    document = identify(log).document
    windows = document["split"]["fit_windows"]
    assert (document["verdict"], document["diverged_windows"]) == ("unexplained", 1)
    assert f"runs away in 1 of {windows} windows" in document["summary"]
