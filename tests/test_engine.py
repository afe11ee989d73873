"""The batch engine against MuJoCo's own mj_step, one simulation at a time."""

from __future__ import annotations

import subprocess
import sys

import mujoco
import numpy as np
import pytest

from capture_cli.model.fields import ModelFields, model_field
from capture_cli.model.states import InitialStates
from capture_cli.model.world import World
from capture_cli.simulate import engine as engine_module
from capture_cli.simulate.engine import Engine, Keep

# A pole on a driven cart, and a ball that drops on the floor beside it: joints, an activation, a contact.
XML = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="cart" pos="0 0 1">
      <joint name="x" type="slide" axis="1 0 0" damping="1" stiffness="5"/>
      <geom type="box" size=".1 .05 .05" mass="1"/>
      <site name="s"/>
      <body name="pole">
        <joint name="theta" type="hinge" axis="0 1 0" damping="0.01"/>
        <geom type="capsule" fromto="0 0 0 0 0 -.5" size=".02" mass=".2"/>
      </body>
    </body>
    <body name="ball" pos="2 0 .2"><freejoint/><geom size=".1" mass=".3"/></body>
  </worldbody>
  <actuator>
    <general name="drive" joint="x" dyntype="filterexact" dynprm=".05" gainprm="4"/>
    <motor name="twist" joint="theta"/>
  </actuator>
  <sensor>
    <jointpos joint="x"/><jointvel joint="theta"/><accelerometer site="s"/>
    <framepos objtype="xbody" objname="ball"/>
  </sensor>
</mujoco>
"""
SIMULATIONS, STEPS = 7, 60


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(XML)


@pytest.fixture
def initial(model) -> InitialStates:
    random = np.random.default_rng(1)
    qpos = np.repeat(model.qpos0[None], SIMULATIONS, axis=0)
    qpos[:, :2] += random.normal(0, 0.2, (SIMULATIONS, 2))
    return InitialStates(
        qpos,
        random.normal(0, 0.5, (SIMULATIONS, model.nv)),
        random.normal(0, 0.1, (SIMULATIONS, model.na)),
        np.arange(SIMULATIONS) / 8,
    )


@pytest.fixture
def controls(model) -> np.ndarray:
    return np.random.default_rng(2).normal(0, 1, (SIMULATIONS, STEPS, model.nu))


@pytest.fixture
def fields(model) -> ModelFields:
    """Mass, damping, gravity and gain that differ in every simulation."""
    fields = ModelFields(model, SIMULATIONS)
    vary = np.linspace(0.5, 2, SIMULATIONS)
    fields["body_mass"][:, 2] *= vary
    fields["body_inertia"][:, 2] *= vary[:, None]
    fields["dof_damping"][:, 0] = 3 * vary
    fields["opt.gravity"][:, 2] *= vary
    fields["actuator_gainprm"][:, 0, 0] = vary
    return fields


def one_by_one(model, initial, controls, fields=None) -> np.ndarray:
    """Sensors (simulation, step, sensordata), each simulation stepped alone by mj_step on a model of its own."""
    sensors = np.zeros((len(initial), STEPS, model.nsensordata))
    for i in range(len(initial)):
        own = mujoco.MjModel.from_xml_string(XML)
        for name, values in (fields.values if fields else {}).items():
            model_field(own, name)[...] = values[i]
        mujoco.mj_setConst(own, mujoco.MjData(own))
        data = mujoco.MjData(own)
        data.qpos, data.qvel, data.act, data.time = (
            initial.qpos[i],
            initial.qvel[i],
            initial.act[i],
            initial.time[i],
        )
        for step in range(STEPS):
            data.ctrl = controls[i, step]
            mujoco.mj_step(own, data)
            sensors[i, step] = data.sensordata
    return sensors


def rollout(model, initial, controls, threads=2, **options):
    return Engine(model, threads).rollout(initial=initial, controls=controls, **options)


def test_first_sensors_are_those_of_the_start(model, initial, controls):
    sensors = rollout(model, initial, controls).sensors
    np.testing.assert_array_equal(sensors[:, 0, 0], initial.qpos[:, 0])
    np.testing.assert_array_equal(sensors[:, 0, 1], initial.qvel[:, 1])
    np.testing.assert_array_equal(sensors[:, 0, 5:], initial.qpos[:, 2:5])


def test_equals_mj_step_bit_for_bit(model, initial, controls):
    np.testing.assert_array_equal(
        rollout(model, initial, controls).sensors, one_by_one(model, initial, controls)
    )


# One tree, of which no two geoms can touch: friction, a limit, a loop and a distance go through other stages.
ARM = """
<mujoco>
  <option timestep="0.002"/>
  <default><joint axis="0 1 0" damping="0.02" frictionloss="0.1"/><geom type="capsule" size=".02"/></default>
  <worldbody>
    <body>
      <joint name="a" limited="true" range="-.5 .5"/>
      <geom name="upper" fromto="0 0 0 0 0 -.2" mass=".5"/>
      <body pos="0 0 -.3">
        <joint name="b"/>
        <geom fromto="0 0 0 .3 0 0" mass=".3"/>
        <body pos=".3 0 0">
          <joint name="c"/>
          <geom name="tip" fromto="0 0 0 .1 0 0" mass=".1" contype="0" conaffinity="0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="c" joint2="b" polycoef="0 .5 0 0 0"/></equality>
  <sensor>
    <jointpos joint="a"/><jointvel joint="b"/><jointpos joint="c"/><distance geom1="upper" geom2="tip" cutoff="1"/>
  </sensor>
</mujoco>
"""


def test_stages_in_which_nothing_happens_are_left_out_to_the_same_bits():
    arm = mujoco.MjModel.from_xml_string(ARM)
    disable = mujoco.mjtDisableBit
    lean = Engine(arm, 1).model
    assert lean.opt.disableflags == disable.mjDSBL_CONTACT | disable.mjDSBL_ISLAND
    assert arm.opt.disableflags == 0
    begin = InitialStates(
        np.array([[0.4, 0.1, 0.05]]), np.array([[1.0, -2.0, 3.0]]), np.zeros((1, 0)), np.zeros(1)
    )
    batch = Engine(arm, 1).rollout(initial=begin, controls=np.zeros((1, 500, 0)))
    data = mujoco.MjData(arm)
    data.qpos, data.qvel = begin.qpos[0], begin.qvel[0]
    sensors, limited = [], False
    for _ in range(500):
        mujoco.mj_step(arm, data)
        sensors.append(data.sensordata.copy())
        limited |= data.nl > 0
    assert limited and np.ptp(sensors, axis=0).min() > 0.005
    np.testing.assert_array_equal(batch.sensors[0], sensors)


def test_contacts_and_islands_are_kept_where_there_can_be_any(model):
    assert Engine(model, 1).model.opt.disableflags == 0


def test_equals_mj_step_with_parameters_of_each_simulation(model, initial, controls, fields):
    batch = rollout(model, initial, controls, fields=fields)
    np.testing.assert_array_equal(batch.sensors, one_by_one(model, initial, controls, fields))
    assert not batch.diverged.any()


def test_parameters_do_not_leak_into_the_next_call(model, initial, controls, fields):
    engine = Engine(model, 1)
    before = engine.rollout(initial=initial, controls=controls).sensors
    engine.rollout(initial=initial, controls=controls, fields=fields)
    after = engine.rollout(initial=initial, controls=controls).sensors
    np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("threads", [2, 3])
def test_same_for_any_number_of_threads(model, initial, controls, fields, threads):
    one = rollout(model, initial, controls, threads=1, fields=fields)
    more = rollout(model, initial, controls, threads=threads, fields=fields)
    np.testing.assert_array_equal(one.sensors, more.sensors)


def test_control_row_picks_the_sequence(model, initial, controls):
    row = np.array([3, 3, 0, 1, 6, 2, 5])
    np.testing.assert_array_equal(
        rollout(model, initial, controls, row=row).sensors,
        rollout(model, initial, controls[row]).sensors,
    )


def test_columns_and_states(model, initial, controls):
    whole = rollout(model, initial, controls, keep=Keep(states=True))
    some = rollout(model, initial, controls, keep=Keep(columns=np.array([5, 0])))
    np.testing.assert_array_equal(some.sensors, whole.sensors[..., [5, 0]])
    assert some.qpos is None
    np.testing.assert_array_equal(whole.qpos[:, 0], initial.qpos)
    np.testing.assert_array_equal(whole.qvel[:, 0], initial.qvel)
    np.testing.assert_array_equal(whole.qpos[..., 0], whole.sensors[..., 0])
    np.testing.assert_array_equal(whole.qvel[..., 1], whole.sensors[..., 1])


DROPPED = """
<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="1 1 .1"/>
  <body pos="0 0 .15"><joint name="z" type="slide" axis="0 0 1"/><geom size=".1"/></body>
</worldbody><sensor><jointpos joint="z"/></sensor></mujoco>
"""


@pytest.mark.parametrize("forces", [(), (lambda world: None,)])
def test_contacts_are_counted_before_each_step(forces):
    model = mujoco.MjModel.from_xml_string(DROPPED)
    start = InitialStates(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 0)), np.zeros(1))
    found = Engine(model, 1).rollout(
        initial=start, controls=np.zeros((1, 120, 0)), forces=forces, keep=Keep(states=True)
    )
    np.testing.assert_array_equal(found.contacts[0], found.sensors[0, :, 0] < -0.05)
    assert 0 < found.contacts.sum() < 120


# --- forces ---


def no_force(world: World) -> None:
    world.qfrc_applied[...] += 0.0


def drag(coefficient: np.ndarray):
    """A force -c v on the cart, c (simulation,)."""

    def force(world: World) -> None:
        world.qfrc_applied[:, 0] -= coefficient[world.rows] * world.qvel[:, 0]

    return force


def implicit_drag(coefficient: np.ndarray):
    def force(world: World) -> None:
        world.vary("dof_damping")[:, 0] += coefficient[world.rows]

    return force


@pytest.fixture
def damped(model) -> tuple[np.ndarray, ModelFields]:
    """Added damping coefficients (simulation,), and the model fields that hold them natively."""
    coefficient = np.linspace(0.1, 3, SIMULATIONS)
    fields = ModelFields(model, SIMULATIONS)
    fields["dof_damping"][:, 0] += coefficient
    return coefficient, fields


def test_no_force_is_the_plain_path_bit_for_bit(model, initial, controls, fields):
    plain = rollout(model, initial, controls, fields=fields, keep=Keep(states=True))
    forced = rollout(model, initial, controls, fields=fields, forces=[no_force], keep=Keep(states=True))
    for name in ("sensors", "qpos", "qvel", "diverged"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(forced, name), err_msg=name)


def test_a_damping_force_is_nearly_native_damping(model, initial, controls, damped):
    coefficient, fields = damped
    plain = rollout(model, initial, controls).sensors[..., 0]
    native = rollout(model, initial, controls, fields=fields).sensors[..., 0]
    forced = rollout(model, initial, controls, forces=[drag(coefficient)]).sensors[..., 0]
    effect = np.abs(native - plain).max()
    assert effect > 5e-3  # m
    assert np.abs(forced - native).max() < 0.02 * effect  # explicit, against implicit


def test_varied_damping_is_native_damping_bit_for_bit(model, initial, controls, damped):
    coefficient, fields = damped
    native = rollout(model, initial, controls, fields=fields)
    forced = rollout(model, initial, controls, forces=[implicit_drag(coefficient)])
    np.testing.assert_array_equal(native.sensors, forced.sensors)


def test_forces_add_up(model, initial, controls):
    third, whole = np.full(SIMULATIONS, 1 / 3), np.full(SIMULATIONS, 1.0)
    np.testing.assert_allclose(
        rollout(model, initial, controls, forces=[drag(third)] * 3).sensors[..., 0],
        rollout(model, initial, controls, forces=[drag(whole)]).sensors[..., 0],
        rtol=1e-12,
    )


# --- chunks ---


@pytest.mark.parametrize("forced", [False, True])
def test_chunks_do_not_change_results(model, initial, controls, fields, damped, monkeypatch, forced):
    options = {"fields": fields, "forces": [drag(damped[0])] if forced else [], "keep": Keep(states=True)}
    whole = rollout(model, initial, controls, **options)
    monkeypatch.setattr(engine_module, "CHUNK_SIMULATIONS", 3)
    parts = rollout(model, initial, controls, **options)
    for name in ("sensors", "qpos", "qvel", "diverged"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name), err_msg=name)


def test_long_rollouts_are_chunked_by_memory(model, monkeypatch):
    monkeypatch.setattr(engine_module, "CHUNK_BYTES", 8 * STEPS * (model.nsensordata + model.nu + 1) * 2)
    assert Engine(model)._chunk(STEPS) == 2
    assert Engine(model)._chunk(100 * STEPS) == 1


# --- divergence ---


@pytest.mark.parametrize("forced", [False, True])
def test_a_diverging_simulation_is_marked_and_harms_no_other(model, initial, controls, forced):
    fields = ModelFields(model, SIMULATIONS)
    fields["opt.gravity"][4, 0] = 1e13
    forces = [no_force] if forced else []
    batch = rollout(model, initial, controls, fields=fields, forces=forces)
    assert batch.diverged.tolist() == [i == 4 for i in range(SIMULATIONS)]
    others = np.arange(SIMULATIONS) != 4
    alone = rollout(model, initial, controls)
    np.testing.assert_array_equal(batch.sensors[others], alone.sensors[others])


def test_a_diverged_simulation_stays_where_it_was_last(model, initial, controls):
    fields = ModelFields(model, SIMULATIONS)
    fields["dof_damping"][1, 0] = -500
    free = rollout(model, initial, controls, fields=fields)
    forced = rollout(model, initial, controls, fields=fields, forces=[no_force])
    assert free.diverged[1] and forced.diverged[1]
    np.testing.assert_array_equal(free.sensors, forced.sensors)
    last = free.sensors[1, -1]
    assert np.abs(last).max() > np.abs(free.sensors[0]).max()
    changes = (free.sensors[1, 1:] != free.sensors[1, :-1]).any(axis=1)
    assert not changes[np.flatnonzero(changes)[-1] + 1 :].any() and not changes[-10:].any()


def test_a_force_that_blows_up_is_marked(model, initial, controls):
    def explode(world: World) -> None:
        world.qfrc_applied[world.rows == 2, 0] = 1e15

    batch = rollout(model, initial, controls, forces=[explode])
    assert batch.diverged.tolist() == [i == 2 for i in range(SIMULATIONS)]
    others = np.arange(SIMULATIONS) != 2
    np.testing.assert_array_equal(
        batch.sensors[others], rollout(model, initial, controls, forces=[no_force]).sensors[others]
    )


def test_divergence_prints_nothing_and_writes_no_log_file(tmp_path):
    program = f"""
import mujoco, numpy as np
from capture_cli.simulate.engine import Engine, InitialStates, ModelFields
model = mujoco.MjModel.from_xml_string('''{XML}''')
fields = ModelFields(model, 50)
fields["opt.gravity"][:, 0] = 1e13
start = InitialStates(model.qpos0[None], np.zeros((1, model.nv)), np.zeros((1, model.na)), np.zeros(1))
for forces in ([], [lambda world: None]):
    done = Engine(model, 2).rollout(
        initial=start.rows(np.zeros(50, int)), controls=np.zeros((50, 20, 2)), fields=fields, forces=forces
    )
    assert done.diverged.all()
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert list(tmp_path.iterdir()) == []


def test_steps_are_the_same_untimed():
    """An engine takes away the clock that MuJoCo's bindings set."""
    model = mujoco.MjModel.from_xml_string(XML)

    def final() -> tuple[np.ndarray, float]:
        data = mujoco.MjData(model)
        data.ctrl = 1.0
        mujoco.mj_step(model, data, 300)
        return data.sensordata.copy(), data.timer[mujoco.mjtTimer.mjTIMER_STEP].duration

    mujoco.set_mjcb_time(None)
    timed, took = final()
    Engine(model, 1)
    untimed, none = final()
    np.testing.assert_array_equal(timed, untimed)
    assert took > 0 and none == 0
