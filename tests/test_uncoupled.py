"""Trees that nothing joins: candidates that each move one are simulated together, to what they are alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from recorded_logs import record_log
from setting_numbers import set_numbers

from capture_cli.estimate.balance.force_balance import ForceBalance
from capture_cli.estimate.balance.forward_dynamics import ForwardDynamics
from capture_cli.estimate.balance.trees import trees
from capture_cli.estimate.log_balance import smoothed_log
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.linearization import columns
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.placed import Placed
from capture_cli.model.tasks import load_task
from capture_cli.simulate.simulator import Simulator
from capture_cli.simulate.uncoupled import SEVERAL, Grouped, ModelTrees

ARM = """
  <body name="{n}_upper" pos="{x} 0 0">
    <joint name="{n}_shoulder" type="hinge" axis="0 1 0" damping="0.2" frictionloss="0.02"/>
    <geom name="{n}_rod" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5" contype="0" conaffinity="0"/>
    <body name="{n}_lower" pos="0 0 -0.3">
      <joint name="{n}_elbow" type="hinge" axis="0 1 0" damping="0.1" frictionloss="0.01" stiffness="0.2"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.3" contype="0" conaffinity="0"/>
      <site name="{n}_tip" pos="0 0 -0.2"/>
    </body>
  </body>
"""
DRIVES = """
  <position name="{n}_servo" joint="{n}_shoulder" kp="6" kv="0.3" ctrlrange="-2 2"/>
  <motor name="{n}_motor" joint="{n}_elbow" ctrlrange="-1 1"/>
"""
SENSORS = """
  <jointpos name="{n}_q1" joint="{n}_shoulder"/> <jointvel name="{n}_v1" joint="{n}_shoulder"/>
  <jointpos name="{n}_q2" joint="{n}_elbow"/>
"""
TASK = """
format = 1
name = "two-arms"
model = "arms.xml"

[log]
time = "t"
window = 0.5
"""
ARMS = ("left", "right")
INPUTS = [
    f'[inputs.{n}_{d}]\ncolumn = "{n}_{d}"\nunit = "{u}"\n'
    for n in ARMS
    for d, u in (("servo", "rad"), ("motor", "N m"))
]
OUTPUTS = [
    f'[outputs.{n}_{s}]\ncolumn = "{n}_{s}"\nunit = "{u}"\n'
    for n in ARMS
    for s, u in (("q1", "rad"), ("v1", "rad/s"), ("q2", "rad"))
]


def machine(more: str = "") -> str:
    bodies, drives, sensors = (
        "".join(part.format(n=n, x=x) for n, x in zip(ARMS, (0, 1), strict=True))
        for part in (ARM, DRIVES, SENSORS)
    )
    return (
        f'<mujoco><option timestep="0.004"/><worldbody>{bodies}</worldbody><actuator>{drives}</actuator>'
        f"<sensor>{sensors}</sensor>{more}</mujoco>"
    )


@pytest.fixture(scope="module")
def prepared(tmp_path_factory) -> PreparedLog:
    folder: Path = tmp_path_factory.mktemp("arms")
    (folder / "arms.xml").write_text(machine(), encoding="utf-8")
    targets = {"damping": (0.0, 0.5), "frictionloss": (0.0, 0.2), "armature": (0.0, 0.05)}
    parameters = [
        f'[parameters.{n}_{j}_{a}]\nset = "joint:{n}_{j}:{a}"\nlow = {low}\nhigh = {high}\nunit = "1"\n'
        for n in ARMS
        for j in ("shoulder", "elbow")
        for a, (low, high) in targets.items()
    ]
    task = folder / "task.toml"
    task.write_text("\n".join([TASK, *parameters, *INPUTS, *OUTPUTS]), encoding="utf-8")
    log = record_log(folder, task, noise=1e-3, episodes=2, duration=1.0, seed=0)
    return prepare(log, load_task(str(task)))


def answers(prepared: PreparedLog, placed: list[Placed], *, near: bool) -> tuple[np.ndarray, int, int]:
    """Changes of the outputs by all columns in the midst of all ranges, and how many candidates they are, in how many
    groups.
    """
    simulator = ModelFits(prepared, 1).simulator(placed)
    data = prepared.data(simulator)
    x = np.full(len(simulator.space), 0.4)
    trial = columns(data, x, np.zeros(data.initial_sd.shape), near=near)
    grouped = Grouped.of(simulator.trees, trial.parameters, trial.corrections)
    outputs, *_ = prepared.answer(simulator, trial)
    count = len(trial.parameters)
    return outputs - outputs[0], count, count if grouped is None else len(grouped.parameters)


def alone(monkeypatch, prepared: PreparedLog, placed: list[Placed], *, near: bool) -> np.ndarray:
    with monkeypatch.context() as patched:
        patched.setattr(Simulator, "trees", None)
        return answers(prepared, placed, near=near)[0]


def places(prepared: PreparedLog, name: str) -> list[Placed]:
    """Where it can sit at the first arm, and elsewhere."""
    kind, model = REGISTRY.get(name), prepared.task.model
    sites = [s for s in kind.sites(model) if "right" not in s]
    return [Placed(name, kind(model, site)) for site in sites]


@pytest.mark.parametrize("name", REGISTRY.names())
def test_an_effect_at_one_tree_does_nothing_to_another(prepared, monkeypatch, name):
    every, apart = places(prepared, name), 0
    for placed in every[:: max(len(every) - 1, 1)]:  # the first and the last
        grouped, count, groups = answers(prepared, [placed], near=False)
        if groups == count:
            continue
        apart += 1
        expected = alone(monkeypatch, prepared, [placed], near=False)
        size = np.abs(expected).max(axis=(1, 2, 3), keepdims=True)
        np.testing.assert_allclose(
            grouped, expected, rtol=0, atol=1e-7 + 1e-4 * size.max(), err_msg=placed.name
        )
        assert groups <= 0.7 * count
    if not apart:
        pytest.skip("its places are of both arms, or of the model")


def test_half_of_the_columns_are_simulated(prepared, monkeypatch):
    found, count, groups = answers(prepared, [], near=False)
    assert groups == 1 + (count - 1) / 2
    np.testing.assert_allclose(found, alone(monkeypatch, prepared, [], near=False), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", [None, "quadratic-drag", "viscoelastic-spring", "compliance", "com-shift"])
def test_to_first_order_they_are_the_same(prepared, monkeypatch, name):
    """Or as simulated: so are parameters of what remembers, and those that are moved with them."""
    set_numbers(monkeypatch, "capture_cli.estimate.prepared_log", agree=np.inf)
    placed = [] if name is None else places(prepared, name)[:1]
    found, count, groups = answers(prepared, placed, near=True)
    near, exact = (alone(monkeypatch, prepared, placed, near=n) for n in (True, False))
    off = [np.abs(found - expected).max(axis=(1, 2, 3)) for expected in (near, exact)]
    assert groups < count and (off[0] == 0).mean() > 0.5
    np.testing.assert_allclose(np.minimum(*off), 0, atol=1e-12)


def test_states_alone_are_simulated_together(prepared, tmp_path):
    """Of a task in which nothing is open."""
    (tmp_path / "arms.xml").write_text(machine(), encoding="utf-8")
    task = tmp_path / "task.toml"
    task.write_text("\n".join([TASK, *INPUTS, *OUTPUTS]), encoding="utf-8")
    prepared = replace(prepared, task=load_task(str(task)))
    _, count, groups = answers(prepared, [], near=False)
    assert (count, groups) == (1 + 8, 1 + 4)


@pytest.mark.parametrize(
    "joined",
    [
        '<equality><joint joint1="left_elbow" joint2="right_elbow"/></equality>',
        '<tendon><spatial><site site="left_tip"/><site site="right_tip"/></spatial></tendon>',
        '<contact><pair geom1="left_rod" geom2="right_rod"/></contact>',
    ],
)
def test_trees_that_are_joined_are_one_machine(joined):
    model = mujoco.MjModel.from_xml_string(machine())
    assert set(ModelTrees.of(model).of_columns) == {0, 1}
    assert ModelTrees.of(mujoco.MjModel.from_xml_string(machine(joined))) is None


def test_a_parameter_of_the_model_as_a_whole_is_of_several_trees(prepared):
    tilt = places(prepared, "gravity-tilt")[0]
    trees = ModelFits(prepared, 1).simulator([tilt]).trees
    assert set(trees.parameters[: len(prepared.task.space)]) == {0, 1}
    assert set(trees.parameters[len(prepared.task.space) :]) == {SEVERAL}


@pytest.mark.parametrize("name", ["payload", "com-shift", "viscous-damping", "gravity-tilt"])
def test_a_balance_is_worked_out_anew_in_trees_that_change(prepared, monkeypatch, name):
    effect = places(prepared, name)[0].effect
    values = effect.space.from_unit(np.full((2, len(effect.space)), [[0.3], [0.6]]))
    smoothed = smoothed_log(prepared, np.arange(len(prepared.windows)))

    def changes() -> tuple[np.ndarray, set[int]]:
        balance, asked = ForceBalance(smoothed, prepared.task.space.nominal), set()
        changed = ForwardDynamics._changed
        with monkeypatch.context() as patched:
            patched.setattr(
                ForwardDynamics, "_changed", lambda *a, **k: asked.add(len(f := changed(*a, **k))) or f
            )
            return np.stack([c.predicted for c in balance.of_effect(effect, values)]), asked

    found, asked = changes()
    monkeypatch.setattr(ForwardDynamics, "_changed", lambda self, model, *_, **__: trees(model))
    expected, _ = changes()
    assert asked == {2 if name == "gravity-tilt" else 1}
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
