"""Policies that know the parameters: acting, training, going on with a training, and being refused."""

from __future__ import annotations

import itertools
import json
import re
import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reaching import Reaching
from safetensors.numpy import load_file, save_file

from capture_cli.context.checkpoints.policy_checkpoint import load_policy
from capture_cli.context.policies import REGISTRY
from capture_cli.context.policies._evaluation import judge
from capture_cli.context.policies.sac import SETTINGS as SAC
from capture_cli.context.policies.sac import Sac
from capture_cli.errors import FitError, OptionError, OutputError, StoreError
from capture_cli.model.tasks.air_hockey import AirHockey
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages import simulated_machine
from capture_cli.stages import train_policy as stage
from capture_cli.stages.gen_histories import gen_histories
from capture_cli.store.histories import Histories
from capture_cli.store.output import unfinished

pytestmark = pytest.mark.usefixtures("without_pages")
ROOT = Path(__file__).resolve().parents[1]
TINY = {"task": "reaching", "steps": 1200, "envs": 50, "evaluations": 6, "width": 16, "batch": 64}
TINY |= {"updates": 25, "learning_rate": 5e-3}


@pytest.fixture(autouse=True)
def reaching(monkeypatch):
    """`train_policy` finds the task "reaching"."""
    load = simulated_machine.load_task
    known = lambda name: Reaching() if name == "reaching" else load(name)  # noqa: E731
    monkeypatch.setattr(simulated_machine, "load_task", known)


@pytest.fixture(scope="module")
def trained(tmp_path_factory, learn) -> Path:
    """A policy for `Reaching`, trained in one go."""
    patch = pytest.MonkeyPatch()
    patch.setattr(simulated_machine, "load_task", lambda name: Reaching())
    out = tmp_path_factory.mktemp("trained") / "policy"
    stage.train_policy(out=out, **TINY)
    patch.undo()
    return out


def network(task, seed: int, width: int = 16) -> Sac:
    """A policy with random weights."""
    generator = np.random.default_rng(seed)
    sizes = itertools.pairwise((len(task.space), width, width, len(task.actions)))
    return Sac(task, [(generator.normal(size=(b, a)), generator.normal(size=b)) for a, b in sizes])


# --- acting ---


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 2 * SAC.block + 3), st.data())
def test_an_action_does_not_depend_on_the_company(seed, count, data):
    task = AirHockey()
    policy = network(task, seed)
    generator = np.random.default_rng(seed)
    parameters = task.space.from_unit(generator.random((count, len(task.space))))
    uniform = generator.random((count, len(task.actions)))
    actions = policy.act(parameters, uniform)
    some = data.draw(st.lists(st.integers(0, count - 1), min_size=1, max_size=9))
    assert np.array_equal(policy.act(parameters[some], uniform[some]), actions[some])
    assert np.all((actions >= task.actions.low) & (actions <= task.actions.high))


@pytest.mark.usefixtures("learn")
def test_the_actor_is_the_one_that_was_trained():
    import torch

    from capture_cli.context.policies.base import TrainingSettings

    task = AirHockey()
    sizes = {"steps": 8, "envs": 4, "updates": 1, "batch": 4, "width": 16, "layers": 2}
    trainer = Sac.trainer(
        Simulator(task, threads=1), TrainingSettings(**sizes, learning_rate=1e-3, entropy=0.1, seed=0)
    )
    coordinates = np.random.default_rng(0).random((20, len(task.space)))
    with torch.no_grad():
        chosen, _ = trainer.sac.predict(coordinates.astype(np.float32), deterministic=True)
    as_it_is = np.full((20, len(task.actions)), 0.9)
    actions = trainer.policy().act(task.space.from_unit(coordinates), as_it_is)
    assert np.allclose(actions, task.actions.from_unit((chosen + 1) / 2), atol=1e-5)


def test_half_of_the_actions_are_those_of_a_mirrored_world():
    task = AirHockey(far_wall=True)
    policy, generator = network(task, 4), np.random.default_rng(4)
    parameters = task.space.from_unit(generator.random((40, len(task.space))))
    straight, turned = (policy.act(parameters, np.full((40, 4), u)) for u in (0.5, 0.49))
    back = policy.act(task.mirror_parameters(parameters), np.full((40, 4), 0.5))
    assert np.array_equal(turned, task.mirror_actions(back))
    assert np.abs(turned - straight).max() > 1e-3
    mirrored = task.mirror_actions(straight)
    simulator = Simulator(task, threads=1)
    one, _ = simulator.trajectories(parameters, straight)
    other, _ = simulator.trajectories(task.mirror_parameters(parameters), mirrored)
    assert np.allclose(one, other * [1, -1], atol=1e-6)
    assert np.allclose(task.reward(straight, one), task.reward(mirrored, other), atol=1e-4)


def test_layers_that_do_not_fit_are_refused():
    task = AirHockey()
    settings_, weights = network(task, 0).state()
    narrow = weights["1.weight"][:, 1:]
    for changed, said in (
        (
            {**weights, "1.weight": narrow},
            rf"1\.weight has shape {re.escape(str(narrow.shape))}, expected \(",
        ),
        (
            {**weights, "0.bias": weights["0.bias"][:, None]},
            r"0\.bias has shape \(\d+, 1\), expected \(\d+,\)",
        ),
        ({n: w for n, w in weights.items() if n != "0.bias"}, r"0\.bias is missing"),
        ({**weights, "9.bias": weights["0.bias"]}, r"9\.bias is one array more"),
    ):
        with pytest.raises(ValueError, match=said):
            Sac.from_state(task, settings_, changed)
    for layers in (0, -1, 2.0, True, 10**18, {}):
        with pytest.raises(ValueError, match=r"settings\.layers is"):
            Sac.from_state(task, {"layers": layers}, weights)
    with pytest.raises(ValueError, match="expected"):
        Sac.from_state(Reaching(), settings_, weights)


# --- what an episode is worth ---


def test_an_episode_that_diverges_is_worth_no_more_than_the_worst():
    trajectories = np.array([[[0.5], [0.5]], [[0.5], [0.7]], [[0.5], [0.5]], [[0.5], [np.nan]]])
    rewards, successes = judge(
        Reaching(), np.zeros((4, 1)), trajectories, np.array([False, False, True, False])
    )
    assert np.allclose(rewards, [1, np.exp(-1), np.exp(-1), np.exp(-1)])
    assert successes.tolist() == [True, False, False, False]
    with pytest.raises(FitError, match="all of 4 episodes diverged"):
        judge(Reaching(), np.zeros((4, 1)), trajectories, np.ones(4, dtype=bool))


@pytest.mark.usefixtures("learn")
def test_the_environments_give_the_rewards_of_the_simulator():
    from capture_cli.context.policies._sac_training import EpisodeVecEnv

    task = AirHockey()
    env = EpisodeVecEnv(Simulator(task, threads=1), 5, seed=3)
    observed = env.reset()
    chosen = np.random.default_rng(0).uniform(-1, 1, (5, len(task.actions))).astype(np.float32)
    following, rewards, dones, infos = env.step(chosen)
    actions = task.actions.from_unit((chosen.astype(float) + 1) / 2)
    trajectories, _ = Simulator(task, threads=1).trajectories(task.space.from_unit(observed), actions)
    assert np.array_equal(rewards, np.float32(task.reward(actions, trajectories)))
    assert dones.all()
    assert not np.isin(following, observed).any()
    assert all(
        np.array_equal(info["terminal_observation"], o) for info, o in zip(infos, observed, strict=True)
    )


# --- training ---


def test_training_beats_the_random_policy(trained):
    document = json.loads((trained / "policy.json").read_text())
    result = document["result"]
    assert result["success"] > 0.8 > 0.2 > result["random"]["success"]
    assert sorted(p.name for p in trained.iterdir()) == [
        "metrics.jsonl",
        "policy.json",
        "policy.safetensors",
        "provenance.json",
        "training.png",
    ]
    curve = [json.loads(line) for line in (trained / "metrics.jsonl").read_text().splitlines()]
    assert [point["step"] for point in curve] == [200 * k for k in range(1, 7)]
    assert curve[-1]["success"] > curve[0]["success"]


def test_a_trained_policy_from_its_checkpoint(trained):
    policy = load_policy(str(trained), Reaching())
    mass = np.array([[0.8], [1.7]])
    assert np.allclose(policy.act(mass, None), mass, atol=0.2)


def test_another_seed_trains_another_policy(trained, tmp_path):
    stage.train_policy(out=tmp_path / "other", **{**TINY, "steps": 100}, seed=1)
    weights, other = (load_file(path / "policy.safetensors") for path in (trained, tmp_path / "other"))
    assert not np.array_equal(weights["0.weight"], other["0.weight"])


@pytest.mark.usefixtures("learn")
def test_training_leaves_nothing_in_the_temporary_directory(tmp_path, monkeypatch):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    stage.train_policy(out=tmp_path / "policy", **{**TINY, "steps": 100})
    assert not list(temporary.iterdir())


def test_an_interrupted_training_goes_on_to_the_same_result(trained, tmp_path, monkeypatch):
    out = tmp_path / "policy"
    with monkeypatch.context() as patch:
        _interrupt(patch, after=7)  # batches of 24; evaluations are 4 apart
        with pytest.raises(KeyboardInterrupt, match="up to the last evaluation is kept"):
            stage.train_policy(out=out, **TINY)
    assert not out.exists()
    with pytest.raises(OutputError, match="unfinished"):
        stage.train_policy(out=out, **TINY)
    with monkeypatch.context() as patch:
        _interrupt(patch, after=20)  # 4 of 24 batches are not made again
        stage.train_policy(out=out, resume=True, force=True, threads=2, **TINY)
    for name in ("policy.safetensors", "metrics.jsonl", "policy.json"):
        assert (out / name).read_bytes() == (trained / name).read_bytes()
    assert stage.train_policy(out=out, resume=True, **TINY) == json.loads((out / "policy.json").read_text())
    with pytest.raises(OptionError, match=r"training\.width was 16, now 8"):
        stage.train_policy(out=out, resume=True, **{**TINY, "width": 8})


@pytest.mark.usefixtures("learn")
def test_a_training_that_diverges(tmp_path):
    with pytest.raises(FitError, match="diverged after"):
        stage.train_policy(out=tmp_path / "policy", **{**TINY, "learning_rate": 1e15})
    assert not (tmp_path / "policy").exists()


@pytest.mark.usefixtures("learn")
def test_going_on_with_another_training_is_refused(tmp_path, monkeypatch):
    out = tmp_path / "policy"
    with monkeypatch.context() as patch:
        _interrupt(patch, after=6)
        with pytest.raises(KeyboardInterrupt, match="up to the last evaluation is kept"):
            stage.train_policy(out=out, **TINY)
    with pytest.raises(OptionError, match=r"training\.width was 16, now 8"):
        stage.train_policy(out=out, resume=True, **{**TINY, "width": 8})
    (unfinished(out) / "state.safetensors").write_bytes(b"no state")
    with pytest.raises(StoreError, match="cannot be read"):
        stage.train_policy(out=out, resume=True, **TINY)


def _interrupt(patch: pytest.MonkeyPatch, after: int) -> None:
    """Training is interrupted in the batch that follows so many."""
    from capture_cli.context.policies._sac_training import SacTrainer

    train, count = SacTrainer.train, iter(range(1000))

    def interrupted(self):
        if next(count) == after:
            raise KeyboardInterrupt
        return train(self)

    patch.setattr(SacTrainer, "train", interrupted)


# --- refusals ---


@pytest.mark.usefixtures("learn")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"policy": "random"}, "--policy random learns nothing"),
        ({"policy": "sack"}, "unknown policy 'sack'"),
        ({"steps": 0}, "--steps 0"),
        ({"envs": 0}, "--envs 0"),
        ({"learning_rate": float("nan")}, "--lr nan"),
        ({"entropy": -0.1}, "--entropy -0.1"),
        ({"device": "tpu"}, "--device 'tpu'"),
    ],
)
def test_options_that_cannot_be_used(tmp_path, options, message):
    with pytest.raises(OptionError, match=message):
        stage.train_policy(out=tmp_path / "policy", **{**TINY, **options})
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("learn")
def test_a_task_without_a_reward_is_refused(tmp_path, slider_task):
    with pytest.raises(OptionError, match="does not say what an episode is worth"):
        stage.train_policy(task=str(slider_task), out=tmp_path / "policy")
    assert not (tmp_path / "policy").exists()


def test_a_policy_for_another_task_is_refused(trained, tmp_path):
    with pytest.raises(OptionError, match="is for the task 'reaching', and this one is 'air-hockey'"):
        gen_histories(task="air-hockey", policy=str(trained), pairs=2, out=tmp_path / "h.zarr")
    assert not list(tmp_path.iterdir())


def test_a_policy_for_other_parameters_is_refused(trained):
    with pytest.raises(OptionError, match=r"made for mass between 0\.5 and 2.*lies between 0\.5 and 4"):
        load_policy(str(trained), Reaching(heaviest=4.0))


def test_a_checkpoint_whose_files_do_not_belong_together_is_refused(trained, tmp_path):
    broken = shutil.copytree(trained, tmp_path / "broken")
    weights = load_file(broken / "policy.safetensors")
    del weights["2.bias"]
    save_file(weights, broken / "policy.safetensors")
    with pytest.raises(StoreError, match="do not belong together"):
        load_policy(str(broken), Reaching())


# --- those shipped ---


@pytest.mark.parametrize("name", ["air-hockey", "scooping"])
def test_the_policies_shipped_make_histories(name, tmp_path):
    policy = str(ROOT / "runs" / "policies" / name)
    for threads in (1, 2):
        gen_histories(
            task=name, policy=policy, pairs=4, rounds=3, out=tmp_path / f"{threads}.zarr", threads=threads
        )
    one, two = (Histories(tmp_path / f"{threads}.zarr").read(0, 4) for threads in (1, 2))
    assert np.array_equal(one["actions"], two["actions"])
    assert np.array_equal(one["measured"], two["measured"])
    assert np.unique(one["actions"][..., 0]).size > 4  # they depend on the parameters


def test_there_is_a_policy_to_train():
    assert [name for name, kind in REGISTRY.items() if kind.trained] == ["sac"]
