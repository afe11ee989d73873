"""Table air hockey: its physics against the formulas, and what its parameters and actions do."""

from __future__ import annotations

import numpy as np
import pytest

from capture_cli.model.fields import ModelFields
from capture_cli.model.states import InitialStates
from capture_cli.model.targets import restitution
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.air_hockey import SETTINGS as AIR_HOCKEY
from capture_cli.model.tasks.air_hockey import TARGET, AirHockey
from capture_cli.simulate.engine import Engine, Keep
from capture_cli.simulate.simulator import Simulator

TASK = AirHockey(far_wall=True)
IMPEDANCE = 0.95  # of a contact of walls and mallet, once the puck is in
STIFFNESS = 4000.0  # 1/s^2
PUCK_X, PUCK_Y = 0, 1  # degrees of freedom
MALLET_X, MALLET_Y = 4, 5


def rollout(seconds: float, parameters: np.ndarray, qpos: np.ndarray, qvel: np.ndarray):
    """States of the plant from qpos, qvel (simulation, ...), the mallet standing still."""
    count, steps = len(parameters), round(seconds / TASK.timestep)
    fields = ModelFields(TASK.model, count)
    TASK.write(fields, parameters)
    initial = InitialStates(qpos, qvel, np.zeros((count, 0)), np.zeros(count))
    controls = np.zeros((1, steps, 2))
    rows = np.zeros(count, dtype=int)
    return Engine(TASK.model, 2).rollout(
        initial=initial, controls=controls, row=rows, fields=fields, keep=Keep(states=True)
    )


def nominal(count: int, **values) -> np.ndarray:
    parameters = np.repeat(TASK.space.nominal[None], count, axis=0)
    for name, value in values.items():
        parameters[:, TASK.space.names.index(name)] = value
    return parameters


def states(count: int, *, at: tuple[float, float], velocity: tuple[float, float] = (0.0, 0.0)):
    qpos = np.repeat(TASK.model.key("start").qpos[None], count, axis=0)
    qvel = np.zeros((count, TASK.model.nv))
    qpos[:, [PUCK_X, PUCK_Y]] = at
    qpos[:, [MALLET_X, MALLET_Y]] = (-0.28, -np.sign(at[1]) * 0.1)
    qvel[:, [PUCK_X, PUCK_Y]] = velocity
    return qpos, qvel


def random_batch(count: int, seed: int, task=TASK):
    generator = np.random.default_rng(seed)
    parameters = task.space.from_unit(generator.random((count, len(task.space))))
    return parameters, task.actions.from_unit(generator.random((count, len(task.actions))))


def formula(damping: np.ndarray) -> np.ndarray:
    """Restitution of a contact of solref (-STIFFNESS, -damping)."""
    return restitution(damping / IMPEDANCE / (2 * np.sqrt(STIFFNESS / IMPEDANCE)))


def test_the_stiffness_is_that_of_the_model():
    assert TASK.model.geom("left_wall").solref[0] == TASK.model.geom("mallet").solref[0] == -STIFFNESS


@pytest.mark.parametrize(("side", "y"), [("left", 0.03), ("right", -0.03)])
def test_deceleration_is_friction_times_gravity(side, y):
    friction = np.linspace(0.03, 0.07, 5)
    moved = rollout(
        0.3, nominal(5, **{f"{side}_friction": friction}), *states(5, at=(-0.2, y), velocity=(0.7, 0))
    )
    steps = slice(50, 300)
    time = TASK.timestep * np.arange(300)[steps]
    deceleration = [-np.polyfit(time, speed[steps], 1)[0] for speed in moved.qvel[:, :, PUCK_X]]
    np.testing.assert_allclose(deceleration, 9.81 * friction, rtol=0.01)
    assert np.abs(moved.qpos[:, :, 2]).max() < 5e-5, "the puck hops"


@pytest.mark.parametrize("speed", [0.25, 0.5, 0.9])
@pytest.mark.parametrize("wall", ["left", "right", "far"])
def test_restitution_of_the_walls(wall, speed):
    damping = np.linspace(3, 40, 7)
    parameters = nominal(7, left_friction=0, right_friction=0, **{f"{wall}_damping": -damping})
    along, sign = (PUCK_X, 1) if wall == "far" else (PUCK_Y, 1 if wall == "left" else -1)
    at = (0.2, 0.01) if wall == "far" else (0.0, 0.02 * sign)
    velocity = (speed, 0.0) if wall == "far" else (0.3, sign * speed)
    moved = rollout(0.45, parameters, *states(7, at=at, velocity=velocity))
    back = (-sign * moved.qvel[:, :, along]).max(axis=1) / speed
    np.testing.assert_allclose(back, formula(damping), atol=0.02)
    if wall != "far":  # a frictionless wall leaves the speed along it
        np.testing.assert_allclose(moved.qvel[:, -1, PUCK_X], 0.3, rtol=1e-3)


@pytest.mark.parametrize("speed", [0.3, 0.4, 0.5])
def test_restitution_of_the_mallet(speed):
    damping = np.linspace(3, 15, 5)
    episodes = TASK.episodes(np.tile([-0.25, 0.0, 0.0, speed], (5, 1)))
    fields = ModelFields(TASK.model, 5)
    TASK.write(fields, nominal(5, left_friction=0, right_friction=0, mallet_damping=-damping))
    engine = Engine(TASK.model, 1)
    moved = engine.rollout(
        initial=episodes.initial,
        controls=TASK.controls(episodes.inputs)[:, :350],
        fields=fields,
        keep=Keep(states=True),
    )
    np.testing.assert_allclose(moved.qvel[:, -1, PUCK_X] / speed - 1, formula(damping), atol=0.02)


def test_restitution_does_not_depend_on_where_between_two_steps_the_puck_arrives():
    qpos, qvel = states(20, at=(0.0, 0.0), velocity=(0.0, 0.4))
    qpos[:, PUCK_Y] += np.linspace(0, 2 * TASK.timestep * 0.4, 20)
    moved = rollout(0.4, nominal(20, left_friction=0, right_friction=0), qpos, qvel)
    assert np.ptp(moved.qvel[:, -1, PUCK_Y]) < 0.005 * 0.4


def test_the_puck_stays_on_the_table_at_the_highest_speed():
    generator = np.random.default_rng(0)
    count = 60
    parameters, _ = random_batch(count, seed=1)
    parameters[:, :2] = TASK.space.low[0]
    direction = generator.uniform(-np.pi, np.pi, count)
    qpos, qvel = states(count, at=(0.0, 0.02))
    qvel[:, PUCK_X], qvel[:, PUCK_Y] = 1.5 * np.cos(direction), 1.5 * np.sin(direction)
    moved = rollout(1.0, parameters, qpos, qvel)
    assert not moved.diverged.any()
    inside = 0.3 - 0.05 + 0.03, 0.12 - 0.05 + 0.03  # walls, less the rim, plus how far a hit presses it in
    assert np.all(np.abs(moved.qpos[:, :, [PUCK_X, PUCK_Y]]) < inside)
    assert np.abs(moved.qpos[:, :, 2]).max() < 1e-3


@pytest.fixture(scope="module")
def moved_by_each() -> dict[str, np.ndarray]:
    """Per parameter, the trajectory difference (episode,) of its two bounds; random actions, the others random."""
    task = AirHockey()
    parameters, actions = random_batch(40, seed=0, task=task)
    simulator = Simulator(task, threads=1)
    found = {}
    for k, name in enumerate(task.space.names):
        ends = [parameters.copy(), parameters.copy()]
        ends[0][:, k], ends[1][:, k] = task.space.low[k], task.space.high[k]
        low, high = (simulator.trajectories(end, actions)[0] for end in ends)
        found[name] = np.linalg.norm(high - low, axis=-1).sum(axis=1)
    return found


def test_every_parameter_matters_to_many_episodes(moved_by_each):
    assert tuple(moved_by_each) == AirHockey().space.names
    for name, difference in moved_by_each.items():
        assert (difference > 0.05).mean() > 0.3, name


def test_domain_randomisation_is_as_far_off_as_in_the_paper():
    task = AirHockey()
    first, actions = random_batch(100, seed=2, task=task)
    second, _ = random_batch(100, seed=3, task=task)
    simulator = Simulator(task, threads=1)
    a, b = (simulator.trajectories(p, actions)[0] for p in (first, second))
    assert 0.2 < np.linalg.norm(a - b, axis=-1).sum(axis=1).mean() < 0.45
    success = task.success(actions, a)
    assert 0.02 < success.mean() < 0.25
    np.testing.assert_array_equal(success, task.reward(actions, a) >= np.exp(-1))


def test_no_start_touches_the_puck():
    corners = np.array(np.meshgrid(*zip(TASK.actions.low, TASK.actions.high, strict=True))).reshape(4, -1).T
    still = TASK.episodes(np.concatenate([corners, TASK.actions.nominal[None]]))
    gap = np.linalg.norm(
        still.initial.qpos[:, [PUCK_X, PUCK_Y]] - still.initial.qpos[:, [MALLET_X, MALLET_Y]], axis=1
    )
    assert gap.min() > 0.07


def test_the_stroke_is_as_fast_and_as_long_as_the_action_says():
    actions = np.array([[-0.25, 0.05, 0.01, 0.4], [-0.22, -0.1, -0.03, 0.5]])
    episodes = TASK.episodes(actions)
    assert episodes.inputs.shape == (2, TASK.grid_steps, 2)
    speed = np.linalg.norm(episodes.inputs, axis=-1)
    np.testing.assert_allclose(speed[:, :50], 0)
    np.testing.assert_allclose(speed[:, 50], actions[:, 3])
    np.testing.assert_allclose(speed[:, -1], 0)
    to_puck = TASK.puck_start - actions[:, :2]
    np.testing.assert_allclose(
        speed.sum(axis=1) * TASK.timestep, np.linalg.norm(to_puck, axis=1) - 0.07 + 0.08, rtol=1e-9
    )


def test_a_puck_on_the_target_is_worth_one():
    trajectories = np.zeros((2, 10, 2))
    trajectories[:, -1] = TARGET, TARGET + 0.75 * AIR_HOCKEY.target_radius
    np.testing.assert_array_equal(TASK.success(np.zeros((2, 4)), trajectories), [True, False])
    assert TASK.reward(np.zeros((2, 4)), trajectories)[0] == 1


def test_five_parameters_and_the_far_wall_as_a_sixth():
    task = load_task("air-hockey")
    assert task.space.names == (
        "left_friction",
        "right_friction",
        "mallet_damping",
        "left_damping",
        "right_damping",
    )
    assert TASK.space.names == (*task.space.names, "far_damping")
    np.testing.assert_allclose(task.space.low, [0.03, 0.03, -15, -40, -40])
    np.testing.assert_allclose(task.space.high, [0.07, 0.07, -3, -3, -3])
