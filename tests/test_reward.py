"""A user's own machine with a reward: what an episode is worth, and the chain from the policy to the evaluation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from capture_cli.errors import OptionError, TaskError
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.aimed_task import AimedTask, with_reward
from capture_cli.model.tasks.reward import Goal, Reward
from capture_cli.report.training import print_policy
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.evaluation.evaluation_run import evaluate
from capture_cli.stages.gen_histories import gen_histories
from capture_cli.stages.identify import identify
from capture_cli.stages.train_policy import train_policy
from capture_cli.stages.train_sysid import train_sysid

ROOT = Path(__file__).resolve().parents[1]
CART = ROOT / "datasets" / "cart"
SHIPPED = ROOT / "runs" / "policies" / "scooping" / "policy.json"


def cart(folder: Path, change: tuple[str, str] = ("", ""), model: tuple[str, str] = ("", "")) -> str:
    """The cart of the datasets, its task.toml and model changed."""
    for name, (before, after) in (("task.toml", change), ("model.xml", model)):
        text = (CART / name).read_text()
        assert before in text
        (folder / name).write_text(text.replace(before, after))
    return str(folder / "task.toml")


def test_goals_are_weighed_and_a_half_is_near():
    goals = (Goal("x", 1.0, 0.1, at=2.0), Goal("y", 0.0, 0.5, weight=3.0))
    reward = Reward(goals, duration=2.0, points=3)
    assert reward.point_times.tolist() == [0.0, 1.0, 2.0]
    trajectories = np.array([[[0, 9], [5, 0], [1, 0]], [[0, 0], [5, 0.5], [1.1, 0.5]]], dtype=float)
    missed = reward.misses(trajectories, ("x", "y"), reward.point_times)
    # where an episode begins does not count
    np.testing.assert_allclose(missed, [[0, 0], [1, 1]])
    np.testing.assert_allclose(reward.worth(missed), [1, 0.5])
    assert reward.worth(np.array([[1.0, 0.0]]))[0] == pytest.approx((0.5 + 3) / 4)


def test_a_time_of_a_goal_is_a_point():
    assert Reward((Goal("x", 0, 1, at=0.3),), 1.0, 2).point_times.tolist() == [0.0, 0.3, 1.0]


def test_an_action_drives_the_machine_from_its_initial_state():
    task = with_reward(load_task(str(CART)))
    assert isinstance(task, AimedTask) and len(task.actions) == 5
    assert (task.actions.low == -15).all() and (task.actions.high == 15).all()
    parameters = np.tile(task.space.nominal, (3, 1))
    pushed = np.array([[0.0] * 5, [5.0] * 5, [-5.0] * 5])
    trajectories, diverged = Simulator(task, threads=1).trajectories(parameters, pushed)
    assert not diverged.any() and np.abs(trajectories[0]).max() == 0
    np.testing.assert_allclose(trajectories[1], -trajectories[2], atol=1e-12)
    # mass, damper and spring under a constant force, at the time of the goal
    mass, damping, stiffness = task.space.nominal
    root = np.sqrt(stiffness / mass - (damping / 2 / mass) ** 2)
    decay = np.exp(-damping / 2 / mass * 0.6)
    wave = np.cos(root * 0.6) + damping / 2 / mass / root * np.sin(root * 0.6)
    assert trajectories[1, -1, 0] == pytest.approx(5 / stiffness * (1 - decay * wave), rel=5e-3)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("duration = 0.6", "", "'duration' is missing"),
        ("duration = 0.6", "duration = 0.6\npoints = 1", "points = 1"),
        ("duration = 0.6", "duration = 0.5", "at = 0.6"),
        ("[reward.outputs.position]", "[reward.outputs.positon]", "no output 'positon'"),
        ("within = 0.01", "within = 0.0", "within = 0"),
        ("within = 0.01", "within = 0.01\nweight = -1.0", "weight = -1"),
        ("within = 0.01", "with = 0.01", "unknown key 'with'"),
        ("[reward.outputs.position]\ntarget = 0.1\nat = 0.6\nwithin = 0.01\n", "", "no goal"),
    ],
)
def test_rewards_that_cannot_be(tmp_path, before, after, message):
    with pytest.raises(TaskError, match=message):
        load_task(cart(tmp_path, (before, after)))


@pytest.mark.usefixtures("learn")
def test_an_input_without_range_cannot_be_explored(tmp_path):
    task = cart(tmp_path, model=('ctrlrange="-15 15"', ""))
    with pytest.raises(TaskError, match="has no ctrlrange"):
        train_policy(task=task, out=tmp_path / "p", steps=64)


@pytest.mark.usefixtures("learn")
def test_a_reward_that_is_constant_is_refused(tmp_path):
    task = cart(tmp_path, model=('ctrlrange="-15 15"', 'ctrlrange="-15 15" gear="0"'))
    with pytest.raises(OptionError, match="each of 64 random episodes is worth"):
        train_policy(task=task, out=tmp_path / "p", steps=64)
    assert not (tmp_path / "p").exists()


@pytest.mark.usefixtures("learn")
def test_a_training_does_not_go_on_with_another_reward(tmp_path, monkeypatch):
    task, out = cart(tmp_path), tmp_path / "p"
    options = {"task": task, "out": out, "steps": 128, "envs": 32, "evaluations": 4, "threads": 1}

    def killed(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("capture_cli.stages.train_policy._Run.finish", killed)
        with pytest.raises(KeyboardInterrupt):
            train_policy(**options)
    cart(tmp_path, ("target = 0.1", "target = 0.05"))
    with pytest.raises(OptionError, match="reward"):
        train_policy(**options, resume=True)


@pytest.mark.usefixtures("learn")
def test_from_the_policy_of_ones_own_machine_to_its_evaluation(tmp_path, without_pages, capsys):
    task, options = str(CART), {"threads": 1}
    made = train_policy(
        task=task, out=tmp_path / "p", steps=1920, envs=32, learning_rate=3e-3, evaluations=1, **options
    )
    assert made["result"]["success"] > made["result"]["random"]["success"] + 0.2
    histories = tmp_path / "h.zarr"
    gen_histories(task=task, out=histories, policy=str(tmp_path / "p"), pairs=40, rounds=3, **options)
    assert "leave --policy out where an identifier is to read logs" in capsys.readouterr().err
    small = {"width": 8, "layers": 1, "heads": 1, "steps": 3, "batch": 16}
    train_sysid(histories=histories, out=tmp_path / "i", identifier="posterior", **small)
    rows = evaluate(
        task=task,
        out=tmp_path / "e",
        policy=str(tmp_path / "p"),
        identifiers=[str(tmp_path / "i"), "least-squares"],
        pairs=10,
        seeds=1,
        rounds=3,
        **options,
    ).document["identifiers"]
    # the policy does better with parameters that were found
    assert rows["least-squares"]["success"][-1] > rows["least-squares"]["success"][0]
    with pytest.raises(OptionError, match="a log has windows"):
        identify(real_log=CART / "cart.zarr", identifier=str(tmp_path / "i"), out=tmp_path / "estimate")


@pytest.mark.parametrize("reward", [0.1, 0.4])
def test_a_policy_no_better_than_random_actions_is_said_to_be(reward, capsys):
    result = {"episodes": 500, "reward": reward, "success": 0.1, "random": {"reward": 0.2, "success": 0.05}}
    print_policy({**json.loads(SHIPPED.read_text()), "result": result}, Console(), Path("p"))
    assert ("no better than random actions" in capsys.readouterr().out) == (reward < 0.2)
