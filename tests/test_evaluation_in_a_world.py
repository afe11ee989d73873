"""Identifiers in a robosuite scene rather than in the plant: `eval-sim2sim --world robosuite`, and who cannot play."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from conftest import draw_nothing

pytest.importorskip("robosuite", reason="needs the extra robosuite")
pytest.importorskip("gymnasium", reason="needs the extra robosuite")

from capture_cli.context.evaluation.evaluation_time import expected
from capture_cli.context.evaluation.sim2sim import Sim2Sim
from capture_cli.context.identifiers import round_identifier
from capture_cli.context.policies.random import Random
from capture_cli.context.worlds import _grip, air_hockey, scooping
from capture_cli.context.worlds.world import World
from capture_cli.errors import CaptureError, FitError, OptionError
from capture_cli.model.tasks import load_task
from capture_cli.report import paper_numbers
from capture_cli.report.evaluation_tables import markdown, tables
from capture_cli.stages.eval_sim2sim import eval_sim2sim
from capture_cli.stages.evaluation import evaluation_run
from capture_cli.stages.evaluation.evaluation_run import evaluate
from capture_cli.stages.record import record
from capture_cli.store.evaluation import Evaluation

pytestmark = pytest.mark.usefixtures("without_pages")
TASK = load_task("scooping")
OPTIONS = {
    "task": "scooping",
    "world": "robosuite",
    "robot": "UR5e",
    "identifiers": ["domain-randomization"],
    "pairs": 2,
    "seeds": 1,
    "rounds": 3,
    "threads": 1,
}


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory) -> Evaluation:
    with pytest.MonkeyPatch.context() as patch:
        draw_nothing(patch)
        return evaluate(out=tmp_path_factory.mktemp("world") / "e", **OPTIONS)


def test_what_is_measured_is_what_the_robot_does(evaluated):
    document, arrays = evaluated.document, evaluated.arrays
    assert (document["world"], document["robot"]) == ("robosuite", "UR5e")
    assert (evaluated.attributes["world"], evaluated.attributes["robot"]) == ("robosuite", "UR5e")
    draw = Sim2Sim(TASK, Random(TASK), 2, 3, threads=1)
    _, target = draw.ends()
    np.testing.assert_array_equal(arrays["target"][0], target)
    estimates, uniform = arrays["estimates"][0, 0], draw._uniform()
    robot = World(TASK, "UR5e").trajectories
    for number in range(2):
        actions = draw.policy.act(estimates[:, number], uniform[:, number])
        measured, _ = robot(target, actions)
        simulated, _ = draw.machine()(estimates[:, number], actions)
        np.testing.assert_array_equal(
            arrays["trajectory_difference"][0, 0, :, number], np.abs(measured - simulated)[:, 0, 0]
        )
        np.testing.assert_array_equal(arrays["success"][0, 0, :, number], measured[:, 0, 0] == 0)


def test_pairs_do_not_depend_on_who_was_played_before():
    parameters, actions = TASK.space.from_unit(np.array([[0.1], [0.9]])), np.array([[-0.75], [0.6]])
    world = World(TASK, "Kinova3")
    once, _ = world.trajectories(parameters, actions)
    again, _ = world.trajectories(parameters[::-1], actions[::-1])
    np.testing.assert_array_equal(once, again[::-1])
    first, second = (world.play(parameters[0], actions[:1])[0].outputs for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_the_arm_lets_the_estimate_be_right_and_the_trajectory_wrong():
    """What no parameter explains stays, at the truth too: the arm is late."""
    task = load_task("air-hockey")
    parameters, actions = task.space.nominal[None], task.actions.nominal[None]
    measured, diverged = World(task).trajectories(parameters, actions)
    simulated, _ = Sim2Sim(task, Random(task), 1, 1, threads=1).machine()(parameters, actions)
    assert not diverged.any() and measured.shape == simulated.shape
    assert np.linalg.norm(measured - simulated, axis=-1).sum() > 0.1


def test_a_run_in_a_world_goes_on_and_is_no_run_in_another(tmp_path, evaluated, monkeypatch):
    options = {**OPTIONS, "out": tmp_path / "e", "identifiers": ["cma-es", "domain-randomization"]}
    keep, count = evaluation_run._keep, iter(range(9))

    def killed(*arguments):
        if next(count) == 1:
            raise KeyboardInterrupt
        keep(*arguments)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt, match="1 of 2 parts"):
        patch.setattr(evaluation_run, "_keep", killed)
        evaluate(**options)
    for other in ({"robot": "Panda"}, {"world": "plant", "robot": None}):
        with pytest.raises(OptionError, match=r"differs: .*robot was "):
            evaluate(**{**options, **other}, resume=True)
    done = evaluate(**options, resume=True)
    for name in ("estimates", "trajectory_difference", "success"):
        np.testing.assert_array_equal(done.arrays[name][1:], evaluated.arrays[name])


def test_an_evaluation_of_version_3_is_one_of_the_plant(tmp_path):
    out = tmp_path / "e"
    evaluate(**{**OPTIONS, "world": "plant", "robot": None, "out": out})
    for name in ("evaluation.json", "evaluation.zarr/zarr.json"):
        found = json.loads((out / name).read_text())
        place = found if name == "evaluation.json" else found["attributes"]
        assert place["version"] == 4
        del place["world"], place["robot"]
        place["version"] = 3
        (out / name).write_text(json.dumps(found))
    read = Evaluation.read(out)
    assert (read.document["world"], read.attributes["robot"]) == ("plant", None)


# --- the paper's figures ---


def test_tables_set_the_papers_real_robots_beside(evaluated):
    assert "played by UR5e" in markdown(evaluated.document)
    rows = next(rows for rows in tables(evaluated.document) if rows.title == "Success")
    shown = dict(zip(rows.header, rows.cells[1], strict=True))
    assert (shown["1"], shown["2"], shown["3"]) == ("0.30", "–", "0.40")  # of 0.9, 0, 0 and 0.9, 0.2, 0.1
    assert "Table III" in rows.note
    assert evaluated.document["table_rounds"] == [1, 3]


def test_the_papers_tables():
    about = {"identifier": "capture", "search": "randomized-binary", "window": 4, "history_rounds": 7}
    real = paper_numbers.trajectory_difference("air-hockey", "none", about, "robosuite")
    assert (real[1], real[9]) == ((0.47, 0.18), (0.27, 0.10))
    assert paper_numbers.success("scooping", "none", about, "robosuite")[9] == pytest.approx(2.5 / 3)
    assert paper_numbers.success("scooping", "none", about, "plant") is None
    for other in ({**about, "window": 2}, {"identifier": "posterior"}):
        assert paper_numbers.success("scooping", "none", other, "robosuite") is None
        assert paper_numbers.trajectory_difference("air-hockey", "none", other, "robosuite") is None


def test_it_is_said_how_long_a_world_takes():
    draw = Sim2Sim(TASK, Random(TASK), 4, 3, threads=1)
    e = type("E", (), {"kind": round_identifier("domain-randomization"), "label": "e"})
    assert expected([(e, draw)]) is None
    found = expected([(e, replace(draw, world=World(TASK)))])
    assert found.rollouts == 4 * 3 + 4 * 3 and found.seconds > 0


# --- who cannot play ---


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"robot": "Pandas"}, "'Pandas' is none of robosuite.*did you mean 'Panda'"),
        ({"robot": "SpotWithArm"}, "stands on no table"),
        ({"robot": "Baxter"}, "--robot Baxter, scooping: within the ranges of its joints .* does not reach"),
        ({"world": "plant"}, "--robot UR5e without --world robosuite"),
        ({"world": "moon"}, "unknown --world 'moon'"),
        ({"task": "scooping-distance"}, "no robosuite scene of 'scooping-distance'"),
        ({"effects": ["control-bias@spatula_x=0.01"]}, "--effect with --world robosuite"),
        ({"suite": "paper", "task": None}, "--world with --suite"),
    ],
)
def test_what_cannot_be_is_said_before_any_work(tmp_path, monkeypatch, options, message):
    monkeypatch.setattr(Sim2Sim, "run", lambda *_: pytest.fail("work was begun"))
    with pytest.raises(CaptureError, match=f"(?s){message}"):
        eval_sim2sim(**{**OPTIONS, **options, "out": tmp_path / "e"})
    assert list(tmp_path.iterdir()) == []


def test_a_robot_that_stands_too_far_off_is_refused(monkeypatch):
    monkeypatch.setattr(air_hockey.TableAirHockey, "table_size", (2.4, 0.8, 0.05))
    with pytest.raises(
        OptionError, match=r"--robot UR5e, air-hockey: within the ranges of its joints"
    ) as caught:
        World(load_task("air-hockey"), "UR5e").try_out()
    assert "Panda" in caught.value.cure


def test_a_robot_whose_controller_does_not_follow_is_refused(monkeypatch):
    monkeypatch.setattr(
        scooping.ObjectScooping, "arm_action", lambda scene, target: np.zeros(scene.action_dim)
    )
    with pytest.raises(OptionError, match="leaves the spatula behind by 100% of the way it is sent"):
        World(TASK).try_out()


def test_a_controller_that_diverges_is_refused(tmp_path, monkeypatch):
    def wild(scene, target):
        scene.sim.data.qvel[scene.robots[0]._ref_joint_vel_indexes] = 1e12
        return np.zeros(scene.action_dim)

    monkeypatch.setattr(scooping.ObjectScooping, "arm_action", wild)
    with pytest.raises(OptionError, match="the robot and its controller diverges"):
        World(TASK).try_out()
    monkeypatch.setattr(World, "try_out", lambda world: None)
    with pytest.raises(FitError, match="diverged in 2 of 2 episodes"):
        record(task="scooping", world="robosuite", episodes=2, out=tmp_path / "log.zarr")
    assert list(tmp_path.iterdir()) == []


def test_who_cannot_take_hold_says_what_may_be_done_in_python():
    assert 'driven_by="servos"' in _grip.Unreachable("x").cure


def test_records_are_of_the_robot_that_was_asked_for(tmp_path):
    options = {"task": "scooping", "world": "robosuite", "episodes": 1, "seed": 2}
    made = {robot: record(robot=robot, out=tmp_path / robot, **options) for robot in ("Panda", "UR5e")}
    assert made["UR5e"].truth["robot"] == "UR5e"
    assert np.abs(made["Panda"].log.outputs - made["UR5e"].log.outputs).max() > 1e-5
    with pytest.raises(OptionError, match="without --world robosuite"):
        record(task="scooping", robot="Panda", out=tmp_path / "plant")


def test_what_is_drawn_first_is_drawn_alike():
    first, second = (World(TASK, "UR5e").scene.outputs for _ in range(2))
    np.testing.assert_array_equal(first, second)
