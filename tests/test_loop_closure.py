"""What closes a loop says where the coordinates in it are: initial states of machines of which few joints are
measured.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_cli.estimate.initial_states.from_outputs import SETTINGS as FROM_OUTPUTS
from capture_cli.estimate.initial_states.from_outputs import (
    InitialStateEstimate,
    Places,
    estimated_initial_states,
)
from capture_cli.log.arrays import Log
from capture_cli.model.loop_closure import LoopClosure, MeasuredPositions
from capture_cli.model.states import InitialStates, corrections_between, shift
from capture_cli.simulate.engine import Engine, Keep

PRESS = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="crank" pos="0 0 1">
      <joint name="crank" axis="0 1 0" damping=".1" armature=".2"/>
      <geom type="capsule" fromto="0 0 0 .1 0 0" size=".01" mass="1" contype="0"/>
      <body name="rod" pos=".1 0 0">
        <joint name="rod" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 -.1 0 -.4" size=".01" mass=".5" contype="0"/>
      </body>
    </body>
    <body name="ram" pos="0 0 .6">
      <joint name="ram" type="slide" axis="0 0 1" stiffness="100"/>
      <geom type="box" size=".05 .05 .05" mass="5" contype="0"/>
    </body>
  </worldbody>
  <equality><connect body1="rod" body2="ram" anchor="-.1 0 -.4" solref="0.004 1"/></equality>
  <actuator><motor joint="crank"/></actuator>
  <sensor><jointpos joint="crank"/></sensor>
</mujoco>
"""
FINGERS = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body><joint name="left" type="slide" axis="0 1 0" damping="2"/><geom size=".01" mass=".1" contype="0"/></body>
    <body pos="0 .1 0">
      <joint name="right" type="slide" axis="0 -1 0" damping="2"/><geom size=".01" mass=".1" contype="0"/>
    </body>
  </worldbody>
  <equality><joint joint1="right" joint2="left" polycoef="0 1 0.5 0 0" solref="0.004 1"/></equality>
  <actuator><motor joint="left"/></actuator>
  <sensor><jointpos joint="left"/></sensor>
</mujoco>
"""
CARRIED = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody>
    <body name="arm"><joint name="arm" axis="0 0 1" damping=".1"/>
      <geom type="capsule" fromto="0 0 0 .5 0 0" size=".02" mass="1" contype="0"/></body>
    <body name="tool" pos=".6 0 0"><freejoint/><geom size=".05" mass=".3" contype="0"/></body>
  </worldbody>
  <equality><weld body1="arm" body2="tool" solref="0.004 1"/></equality>
  <actuator><motor joint="arm"/></actuator>
  <sensor><jointpos joint="arm"/></sensor>
</mujoco>
"""
MACHINES = {"press": (PRESS, 3.0), "fingers": (FINGERS, 0.2), "carried": (CARRIED, 0.5)}
STEPS, EVERY, NOISE = 3000, 4, 1e-4


def driven(xml: str, size: float):
    """The model, its sampled times, and the true rollout there: one joint is driven, and turns several times over."""
    model = mujoco.MjModel.from_xml_string(xml)
    time = model.opt.timestep * np.arange(STEPS)
    still = InitialStates(model.qpos0[None] + 0.0, np.zeros((1, model.nv)), np.zeros((1, 0)), np.zeros(1))
    drive = size * (0.5 + np.sin(4 * time))
    done = Engine(model, 1).rollout(initial=still, controls=drive[None, :, None], keep=Keep(states=True))
    return model, time[::EVERY], done.sensors[0, ::EVERY], done.qpos[0, ::EVERY], done.qvel[0, ::EVERY]


def estimated(model, time, outputs, at, believed=None) -> InitialStateEstimate:
    return estimated_initial_states(
        model,
        [0],
        Places(Log(time, outputs, [slice(0, len(time))]), at, np.zeros(len(at), dtype=int)),
        np.full(1, NOISE),
        unmeasured=believed or astray(model, len(at), 0),
    )


def astray(model, count: int, seed: int) -> InitialStateEstimate:
    """What is believed of coordinates that nothing measures: anything."""
    random = np.random.default_rng(seed)
    qpos = np.repeat(model.qpos0[None], count, axis=0)
    for row in qpos:
        mujoco.mj_integratePos(model, row, random.normal(0, 1.0, model.nv), 1.0)
    qvel = random.normal(0, 1.0, (count, model.nv))
    sd = np.full((count, 2 * model.nv), 3.0)
    return InitialStateEstimate(InitialStates(qpos, qvel, np.zeros((count, 0)), np.zeros(count)), sd)


def errors(model, initial: InitialStates, qpos, qvel) -> np.ndarray:
    """(window, state), in the tangent space."""
    apart = np.zeros((len(initial), model.nv))
    for row, here, there in zip(apart, initial.qpos, qpos, strict=True):
        mujoco.mj_differentiatePos(model, row, 1.0, there, here)
    return np.concatenate([apart, initial.qvel - qvel], axis=1)


@pytest.mark.parametrize("name", MACHINES)
def test_what_nothing_measures_follows_from_the_loop(name):
    model, time, outputs, qpos, qvel = driven(*MACHINES[name])
    noisy = outputs + np.random.default_rng(1).normal(0, NOISE, outputs.shape)
    at = np.arange(100, len(time) - 100, 50)
    found = estimated(model, time, noisy, at)
    off = errors(model, found.states, qpos[at], qvel[at])
    assert np.abs(off[:, : model.nv]).max() < 20 * NOISE
    assert np.abs(off[:, model.nv :]).max() < 0.1
    assert (
        np.abs(off) < FROM_OUTPUTS.prior_inflation * found.sd + 1e-6
    ).all()  # within what it says it is known to
    assert found.sd[:, : model.nv].max() < 0.01  # where anything had been possible


def test_the_press_turns_over():
    _, _, outputs, _, _ = driven(*MACHINES["press"])
    assert np.ptp(outputs) > 4 * np.pi  # so that the phase of a simulation would be of no use


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31), name=st.sampled_from(sorted(MACHINES)))
def test_starts_satisfy_the_constraints_wherever_one_begins(seed, name):
    model, time, outputs, *_ = driven(*MACHINES[name])
    at = np.array([len(time) // 2])
    found = estimated(model, time, outputs, at, astray(model, 1, seed)).states
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = found.qpos[0], found.qvel[0]
    mujoco.mj_forward(model, data)
    assert np.abs(data.efc_pos[: data.ne]).max() < 1e-4
    assert np.abs(data.efc_vel[: data.ne]).max() < 0.05


def test_what_no_constraint_determines_stays_where_it_was():
    model, time, outputs, *_ = driven(CARRIED.replace("<weld", '<connect anchor="0 0 0"'), 0.5)
    found = estimated(model, time, outputs, np.array([300]))
    turned = slice(model.nv - 3, model.nv)  # the tool may turn about the point where it is held
    assert (found.sd[0, turned] > 0.5).all()


def test_without_constraints_nothing_changes():
    _, time, outputs, *_ = driven(FINGERS, 0.2)
    loose = mujoco.MjModel.from_xml_string(
        FINGERS.replace("<equality>", "<!--").replace("</equality>", "-->")
    )
    at = np.array([200, 400])
    believed = astray(loose, 2, 5)
    found = estimated(loose, time, outputs, at, believed)
    assert np.array_equal(found.states.qpos[:, 1], believed.states.qpos[:, 1])
    assert np.array_equal(found.sd[:, 1], believed.sd[:, 1])


def test_an_episode_without_windows_is_not_followed():
    model, time, outputs, *_ = driven(*MACHINES["press"])
    followed = LoopClosure(model).follow(
        time, MeasuredPositions(outputs, np.array([0]), np.array([0]), np.full(1, NOISE)), model.qpos0, at=[]
    )
    assert followed.shape == (0, model.nq)


# Two light fingers that a constraint couples, as soft as MuJoCo has it by default: their drive would accelerate
# one alone by 300 m/s^2.
SOFT = FINGERS.replace('solref="0.004 1"', "").replace("mass=", 'mass=".01" density=')
SOFT = SOFT.replace("</sensor>", '<jointpos joint="right"/></sensor>')


@pytest.mark.parametrize("sensors", [[0], [0, 1]])
def test_constraints_are_as_soft_as_loads_have_them(sensors):
    model = mujoco.MjModel.from_xml_string(SOFT)
    time = model.opt.timestep * np.arange(STEPS)
    still = InitialStates(model.qpos0[None] + 0.0, np.zeros((1, model.nv)), np.zeros((1, 0)), np.zeros(1))
    controls = 3 * np.sin(20 * time)[None, :, None]
    done = Engine(model, 1).rollout(initial=still, controls=controls, keep=Keep(states=True))
    slack = LoopClosure(model).slack_of(done.qpos[0], done.qvel[0])
    assert slack.shape == (2, 1) and slack[0, 0] > 10 * NOISE
    at = np.arange(100, STEPS // EVERY - 100, 50)
    off = {}
    for known in (None, slack):
        found = estimated_initial_states(
            model,
            sensors,
            Places(
                Log(time[::EVERY], done.sensors[0, ::EVERY][:, sensors], [slice(0, STEPS // EVERY)]),
                at,
                np.zeros(len(at), dtype=int),
            ),
            np.full(len(sensors), NOISE),
            unmeasured=astray(model, len(at), 0),
            slack=known,
        )
        off[known is None] = (
            np.abs(errors(model, found.states, done.qpos[0, ::EVERY][at], done.qvel[0, ::EVERY][at]))
            / found.sd
        )
    assert off[True].max() > 10, "further off than anything that they are said to be known to"
    assert off[False].max() < 2


@pytest.mark.parametrize("name", MACHINES)
def test_a_start_may_leave_a_constraint_as_far_as_that_gives_way(name):
    model, *_, qpos, qvel = driven(*MACHINES[name])
    at = slice(1000 // EVERY, 1001 // EVERY + 1)
    initial = InitialStates(qpos[at], qvel[at], np.zeros((1, 0)), np.zeros(1))
    sd = np.concatenate([np.full((1, model.nv), 0.1), np.full((1, model.nv), 1.0)], axis=1)
    rows = len(LoopClosure(model).slack_of(qpos[at], qvel[at])[0])
    far = 1e9 * np.ones((2, rows))  # so far that they say nothing
    found, left = LoopClosure(model, far).close(initial, sd, qpos[at])
    np.testing.assert_allclose(found.together[0], np.tile(np.eye(model.nv), (2, 1, 1)), atol=1e-6)
    np.testing.assert_allclose(left, sd, rtol=1e-6)


@pytest.mark.parametrize("name", MACHINES)
def test_a_start_moves_as_the_constraints_let_it(name):
    """One coordinate that moved alone would be thrown back, and nothing smooth would come of it."""
    model, time, outputs, *_ = driven(*MACHINES[name])
    found = estimated(model, time, outputs, np.array([len(time) // 2])).states
    moves = 1e-4 * np.eye(2 * model.nv)

    def broken(initial: InitialStates) -> float:
        """By how much, at most, constraints are off more than before by a move of positions, and their rates by one of
        velocities.
        """
        moved = shift(model, initial.rows(np.zeros(2 * model.nv, dtype=int)), moves)
        data, off = mujoco.MjData(model), []
        for qpos, qvel in zip([*found.qpos, *moved.qpos], [*found.qvel, *moved.qvel], strict=True):
            data.qpos[:], data.qvel[:] = qpos, qvel
            mujoco.mj_forward(model, data)
            off.append([data.efc_pos[: data.ne].copy(), data.efc_vel[: data.ne].copy()])
        off = np.abs(np.array(off[1:]) - off[0])
        return max(off[: model.nv, 0].max(), off[model.nv :, 1].max())

    alone = broken(replace(found, together=None))
    assert alone > 1e-5
    assert broken(found) < 0.02 * alone
    once = (found.together[0] @ moves.reshape(-1, 2, model.nv, 1)).reshape(-1, 2 * model.nv)
    twice = (found.together[0] @ once.reshape(-1, 2, model.nv, 1)).reshape(-1, 2 * model.nv)
    np.testing.assert_allclose(twice, once, atol=0.02 * 1e-4)  # what they let pass they let pass whole


@pytest.mark.parametrize("name", MACHINES)
def test_offsets_between_starts_lead_from_one_to_the_other(name):
    model, time, outputs, *_ = driven(*MACHINES[name])
    begin = estimated(model, time, outputs, np.array([len(time) // 2])).states
    end = shift(model, begin, np.random.default_rng(3).normal(scale=1e-3, size=(1, 2 * model.nv)))
    there = shift(model, begin, corrections_between(model, begin, end))
    np.testing.assert_allclose(there.qpos, end.qpos, atol=1e-6)
    np.testing.assert_allclose(there.qvel, end.qvel, atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(first=st.integers(0, 600), turns=st.integers(-3, 3))
def test_an_episode_may_begin_anywhere(first, turns):
    """The crank's first angle may be far from the model's own, and an encoder counts turns that were before the log."""
    model, time, outputs, qpos, _ = driven(*MACHINES["press"])
    outputs = outputs + 2 * np.pi * turns
    found = estimated(model, time[first:], outputs[first:], np.array([0])).states
    assert abs(found.qpos[0, 0] - outputs[first, 0]) < 20 * NOISE
    np.testing.assert_allclose(np.exp(1j * found.qpos[0, 1]), np.exp(1j * qpos[first, 1]), atol=20 * NOISE)
    np.testing.assert_allclose(found.qpos[0, 2], qpos[first, 2], atol=20 * NOISE)


def test_a_fast_crank_is_followed_through_sparse_samples():
    model, time, outputs, qpos, _ = driven(*MACHINES["press"])
    few = slice(None, None, 25)  # up to a radian apart
    time, outputs, qpos = time[few], outputs[few], qpos[few]
    assert np.abs(np.diff(outputs[:, 0])).max() > 0.8
    crank = np.array([0])
    at = np.arange(len(time))
    followed = LoopClosure(model).follow(
        time, MeasuredPositions(outputs, crank, crank, np.full(1, NOISE)), model.qpos0, at
    )
    np.testing.assert_allclose(followed, qpos, atol=20 * NOISE)


@pytest.mark.parametrize("off", [0.0, 0.3])
def test_outputs_that_contradict_a_loop_are_named(off):
    """A crank whose encoder has its zero elsewhere does not go with where the ram is."""
    xml = PRESS.replace("</sensor>", '<jointpos joint="ram"/></sensor>').replace(
        "<connect ", '<connect name="pin" '
    )
    model, time, _, qpos, _ = driven(xml, MACHINES["press"][1])
    noise = np.full(2, NOISE)
    outputs = qpos[:, [0, 2]] + [off, 0] + np.random.default_rng(2).normal(0, NOISE, (len(time), 2))
    at = np.arange(0, len(time), 100)
    found = estimated_initial_states(
        model,
        [0, 1],
        Places(Log(time, outputs, [slice(0, len(time))]), at, np.zeros(len(at), dtype=int)),
        noise,
    )
    assert list(found.open_loops) == ["pin"] * bool(off)
    assert all(0.003 < gap < 0.1 for gap in found.open_loops.values())
