"""Initial states from noisy logs: within what they say they are known to, for every kind of joint."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from capture_cli.estimate.initial_states.from_outputs import SETTINGS as FROM_OUTPUTS
from capture_cli.estimate.initial_states.from_outputs import (
    InitialStateEstimate,
    Places,
    estimated_initial_states,
    from_episodes,
    known_initial,
    model_initial_states,
)
from capture_cli.estimate.initial_states.local_motion import Neighbours, local_motion
from capture_cli.log.arrays import Log
from capture_cli.model import effects
from capture_cli.model.coordinate_sources import measures_every_coordinate, sources_of, unmeasured_joints
from capture_cli.model.states import InitialStates, corrections_between, shift
from capture_cli.simulate.engine import Engine, Keep, Rollouts

# A carriage on a spring, a pendulum on a ball joint, and a body that flies: every kind of coordinate.
XML = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="carriage">
      <joint name="x" type="slide" axis="1 0 0" stiffness="40"/>
      <geom size=".1" mass="1"/>
    </body>
    <body name="pendulum" pos="0 0 2">
      <joint name="ball" type="ball"/>
      <geom type="capsule" fromto="0 0 0 .1 0 -.5" size=".02" mass="1"/>
    </body>
    <body name="flyer" pos="3 0 5"><freejoint/><geom type="box" size=".3 .2 .1" mass="1"/></body>
  </worldbody>
  <sensor>
    <jointpos name="x" joint="x"/>
    <ballquat name="ball" joint="ball"/>
    <framepos name="where" objtype="xbody" objname="flyer"/>
    <framequat name="how" objtype="xbody" objname="flyer"/>
    <jointvel name="v" joint="x"/>
  </sensor>
</mujoco>
"""
STEPS, EVERY = 600, 2  # model steps, and how many of them to one sample


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(XML)


@pytest.fixture(scope="module")
def motion(model):
    """One episode in which everything moves: time (step,), and the true rollout at those samples."""
    random = np.random.default_rng(3)
    start = InitialStates(
        model.qpos0[None] + 0.0, random.normal(0, 1.0, (1, model.nv)), np.zeros((1, 0)), np.zeros(1)
    )
    done = Engine(model, 1).rollout(initial=start, controls=np.zeros((1, STEPS, 0)), keep=Keep(states=True))
    sampled = slice(None, None, EVERY)
    return (
        model.opt.timestep * np.arange(STEPS)[sampled],
        done.sensors[0, sampled],
        done.qpos[0, sampled],
        done.qvel[0, sampled],
    )


def columns(model, *names: str) -> np.ndarray:
    """The columns of sensordata of the sensors `names`."""
    sensors = [model.sensor(name) for name in names]
    return np.concatenate([s.adr[0] + np.arange(s.dim[0]) for s in sensors])


def estimate(
    model, motion, names, noise: float, first=None, sampled=None, **options
) -> tuple[InitialStateEstimate, np.ndarray]:
    """Initial states of windows that begin at the steps `first`, from noisy outputs, and their true tangent error."""
    time, sensors, qpos, qvel = motion
    first = np.arange(0, len(time) - 60, 30) if first is None else first
    data = columns(model, *names)
    outputs = sensors[:, data] + noise * np.random.default_rng(4).standard_normal((len(time), len(data)))
    outputs = outputs if sampled is None else np.where(sampled, outputs, 1e3)
    log = Log(time, outputs, [slice(0, len(time))], sampled=sampled)
    places = Places(log, first, np.zeros(len(first), dtype=int))
    found = estimated_initial_states(model, data, places, np.full(len(data), max(noise, 1e-9)), **options)
    error = np.zeros((len(first), 2 * model.nv))
    for row, step in enumerate(first):
        mujoco.mj_differentiatePos(model, error[row, : model.nv], 1.0, qpos[step], found.states.qpos[row])
        error[row, model.nv :] = found.states.qvel[row] - qvel[step]
    return found, error


ALL = ("x", "ball", "where", "how")


def test_errors_are_within_the_standard_deviation_and_that_is_not_idle(model, motion):
    found, error = estimate(model, motion, ALL, noise=1e-3)
    in_sd = np.abs(error) / found.sd  # the sd is a prior's, of a local fit inflated by prior_inflation
    assert in_sd.max() < 1
    assert in_sd.max(axis=0).min() > 0.3 / FROM_OUTPUTS.prior_inflation


def test_an_attitude_is_known_alike_about_every_axis(model):
    """Near level w has no noise to speak of, and x, y and z half of the rotation's each."""
    found = known_initial(
        model,
        columns(model, "how"),
        model_initial_states(model, 2).states,
        np.array([1e-6, 1e-3, 1e-3, 1e-3]),
    )
    flyer = slice(7, 10)
    np.testing.assert_allclose(found.sd[:, flyer], FROM_OUTPUTS.prior_inflation * 2e-3, rtol=1e-6)
    assert found.sd.sum() == pytest.approx(found.sd[:, flyer].sum())


def test_better_than_one_sample_and_one_difference(model, motion):
    noise, interval = 1e-3, EVERY * 0.002
    _, error = estimate(model, motion, ALL, noise=noise)
    rms = np.sqrt(np.mean(error**2, axis=0))
    assert rms[: model.nv].max() < 2 * noise
    assert rms[model.nv :].max() < 0.4 * np.sqrt(2) * noise / interval


def test_less_noise_smaller_sd_and_smaller_error(model, motion):
    coarse, fine = (estimate(model, motion, ALL, noise=n) for n in (3e-3, 3e-5))
    assert (fine[0].sd.mean(axis=0) < 0.2 * coarse[0].sd.mean(axis=0)).all()
    assert np.abs(fine[1]).mean() < 0.2 * np.abs(coarse[1]).mean()


def test_without_noise_the_velocity_is_the_one_the_integrator_means(model, motion):
    """It is the path's slope half a model step earlier: one without that correction is far off here."""
    time, sensors, _, qvel = motion
    found, error = estimate(model, motion, ALL, noise=0.0)
    assert np.abs(error).max() < 1e-4
    assert (np.abs(error) < 2 * found.sd).all()
    slope = np.gradient(sensors[:, 0], time, edge_order=2)
    assert np.abs(slope - qvel[:, 0]).max() > 10 * np.abs(error[:, model.nv]).max()


def test_runge_kutta_has_no_such_lag():
    spring = mujoco.MjModel.from_xml_string("""
        <mujoco>
          <option timestep="0.002" integrator="RK4"/>
          <worldbody><body><joint name="x" type="slide" stiffness="40"/><geom size=".1" mass="1"/></body></worldbody>
          <sensor><jointpos name="x" joint="x"/></sensor>
        </mujoco>""")
    time = spring.opt.timestep * np.arange(STEPS)
    start = InitialStates(np.ones((1, 1)), np.zeros((1, 1)), np.zeros((1, 0)), np.zeros(1))
    done = Engine(spring, 1).rollout(initial=start, controls=np.zeros((1, STEPS, 0)), keep=Keep(states=True))
    _, error = estimate(spring, (time, done.sensors[0], done.qpos[0], done.qvel[0]), ("x",), noise=0.0)
    assert np.abs(error).max() < 1e-4  # of 6 m/s


def test_a_few_unlucky_samples_do_not_make_a_start_wild():
    """At the start of an episode the narrowest fit has seven samples: of many, some do not look like their noise."""
    generator = np.random.default_rng(0)
    time, noise = np.arange(60) / 250, 5e-4
    tracks = np.stack([0.9 * time - 0.5 * time**2] * 2000, axis=1)
    measured = tracks + noise * generator.standard_normal(tracks.shape)
    near = Neighbours.of(time, np.array([0]), np.array([0]), np.array([len(time)]))
    found = local_motion(near, measured[near.index], np.full(tracks.shape[1], noise))
    assert np.abs(found.slope - 0.9).max() < 0.5
    assert np.abs((found.slope - 0.9) / found.slope_sd).max() < 6


@pytest.mark.parametrize("every", [2, 4])
def test_starts_by_a_slow_sensor_are_as_well_known_as_they_say(model, motion, every):
    """Windows begin between its samples, too; what it says of them is what a log of its samples alone says."""
    time, sensors, qpos, qvel = motion
    sampled = np.broadcast_to((np.arange(len(time)) % every == 0)[:, None], (len(time), 12))
    first = np.arange(1, len(time) - 60, 31)
    found, error = estimate(model, motion, ALL, noise=1e-3, sampled=sampled, first=first)
    in_sd = np.abs(error) / found.sd
    assert in_sd.max() < 1.2
    assert in_sd.max(axis=0).min() > 0.2 / FROM_OUTPUTS.prior_inflation
    at = np.arange(0, len(time) - 60, 10 * every)
    some, whole = (
        estimate(model, (time, sensors, qpos, qvel), ALL, noise=0.0, sampled=sampled, first=at)[0],
        estimate(
            model,
            (time[::every], sensors[::every], qpos[::every], qvel[::every]),
            ALL,
            noise=0.0,
            first=at // every,
        )[0],
    )
    for name in ("qpos", "qvel"):
        np.testing.assert_allclose(getattr(some.states, name), getattr(whole.states, name), atol=1e-9)
    np.testing.assert_allclose(some.sd, whole.sd, rtol=1e-6)


def test_a_slow_sensor_leaves_what_others_say(model, motion):
    """Position at every step, and a velocity that is seen now and then."""
    every = np.ones((len(motion[0]), 2), dtype=bool)
    slow = every.copy()
    slow[:, 1] = np.arange(len(every)) % 5 == 0
    found, _ = estimate(model, motion, ("x", "v"), noise=1e-3, sampled=slow)
    whole, _ = estimate(model, motion, ("x", "v"), noise=1e-3, sampled=every)
    position, velocity = (np.s_[:, 0], np.s_[:, model.nv])
    assert np.array_equal(found.sd[position], whole.sd[position])
    assert found.sd[velocity].min() > whole.sd[velocity].min()


def test_long_before_a_sample_nothing_is_sure(model, motion):
    time = motion[0]
    sampled = np.ones((len(time), 1), dtype=bool)
    sampled[: len(time) // 2] = False
    found, error = estimate(model, motion, ("x",), noise=1e-3, sampled=sampled, first=np.array([0, 60, 200]))
    assert found.sd[0, 0] > found.sd[1, 0] > 100 * found.sd[2, 0]
    assert (np.abs(error[:, [0, model.nv]]) < found.sd[:, [0, model.nv]]).all()


def test_a_measured_velocity_is_used(model, motion):
    found, error = estimate(model, motion, ("x", "v"), noise=1e-3)
    derived, _ = estimate(model, motion, ("x",), noise=1e-3)
    assert found.sd[:, model.nv].max() < 0.2 * derived.sd[:, model.nv].min()
    assert np.abs(error[:, model.nv]).max() < 4e-3


def test_a_velocity_that_is_cut_off_is_left_open(model, motion):
    """Where a window begins beyond the sensor's range: what is there may be as much again."""
    time, sensors, qpos, qvel = motion
    cut = sensors.copy()
    column = model.sensor("v").adr[0]
    limit = 0.8 * np.abs(cut[:, column]).max()
    cut[:, column] = np.clip(cut[:, column], -limit, limit)
    found, error = estimate(model, (time, cut, qpos, qvel), ("x", "v"), noise=1e-3)
    beyond = np.abs(error[:, model.nv]) > 0.05 * limit
    assert beyond.any() and not beyond.all()
    assert (np.abs(error[:, model.nv]) < found.sd[:, model.nv]).all()
    assert (found.sd[beyond, model.nv] > 0.9 * limit).all()
    inside, _ = estimate(model, motion, ("x", "v"), noise=1e-3)
    assert (found.sd[:, model.nv] < 1.1 * inside.sd[:, model.nv].max()).any()


def test_quaternions_are_unit_even_where_the_log_rounds_them(model, motion):
    found, _ = estimate(model, motion, ALL, noise=5e-3)
    for part in (found.states.qpos[:, 1:5], found.states.qpos[:, 8:12]):
        np.testing.assert_allclose(np.linalg.norm(part, axis=1), 1, rtol=1e-12)


def test_a_quaternion_that_changes_its_sign_is_the_same_orientation(model, motion):
    time, sensors, qpos, qvel = motion
    flipped = sensors.copy()
    flipped[40:, columns(model, "ball")] *= -1
    _, plain = estimate(model, motion, ("ball",), noise=0.0)
    _, error = estimate(model, (time, flipped, qpos, qvel), ("ball",), noise=0.0)
    np.testing.assert_allclose(error, plain, atol=1e-9)


@pytest.mark.parametrize("turned", [0.5, 1.0, 1.5])
def test_an_attitude_may_turn_by_more_than_half_a_turn_within_reach(turned):
    """rad from sample to sample: those beside a start are up to six radians away."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody><body name="top"><freejoint/>
        <geom type="box" size=".1 .1 .1" mass="1"/></body></worldbody>
        <sensor><framequat name="how" objtype="body" objname="top"/></sensor></mujoco>"""
    )
    data = mujoco.MjData(model)
    rate = turned / 0.02 * np.array([2.0, 1.0, 2.0]) / 3
    data.qvel[3:] = rate
    outputs = []
    for _ in range(60):
        mujoco.mj_step(model, data, 2)
        mujoco.mj_forward(model, data)
        outputs.append(data.sensordata.copy())
    outputs = np.array(outputs) + 2e-3 * np.random.default_rng(0).standard_normal((60, 4))
    found = estimated_initial_states(
        model,
        range(4),
        Places(
            Log(0.02 * np.arange(60), outputs, [slice(0, 60)]),
            np.array([0, 20, 40]),
            np.zeros(3, dtype=int),
        ),
        np.full(4, 2e-3),
    )
    assert (np.abs(found.states.qvel[:, 3:] - rate) < found.sd[:, 9:]).all()
    assert np.linalg.norm(found.states.qvel[1, 3:] - rate) < 0.02 * np.linalg.norm(rate)


TUMBLING = """
<mujoco><option timestep="0.001" gravity="0 0 0" integrator="RK4"/><worldbody><body name="box"><freejoint/>
  <geom type="box" size=".05 .1 .02" mass=".5"/></body></worldbody>
<sensor><framequat name="how" objtype="xbody" objname="box"/></sensor></mujoco>
"""


@pytest.mark.parametrize(
    ("spin", "lost", "off"),
    [(12, 0, 0.05), (30, 0, 0.1), (30, 0.3, 0.25), (45, 0, 0.12), (60, 0, 0.25)],
    ids=["0.24 rad a sample", "0.6", "0.6 and more", "0.9", "1.2"],
)
def test_the_turning_of_a_tumbling_body_is_known_at_both_ends_of_an_episode(spin, lost, off):
    """spin: rad/s, of samples 20 ms apart, a share of which is `lost`. A fit begins near enough `off` of it away."""
    model = mujoco.MjModel.from_xml_string(TUMBLING)
    generator = np.random.default_rng(2)
    axes = generator.normal(size=(6, 3))
    start = model_initial_states(model, 6).states
    start.qvel[:, 3:] = spin * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    done = Engine(model, 1).rollout(initial=start, controls=np.zeros((6, 1000, 0)), keep=Keep(states=True))
    for sensors, qpos, qvel in zip(
        *(a[:, :1000:20] for a in (done.sensors, done.qpos, done.qvel)), strict=True
    ):
        kept = np.flatnonzero(generator.random(50) >= lost)
        motion = (0.02 * kept, sensors[kept], qpos[kept], qvel[kept])
        first = np.array([0, len(kept) // 2, len(kept) - 1])
        found, error = estimate(model, motion, ("how",), noise=1e-3, first=first)
        assert np.linalg.norm(error[:, 9:], axis=1).max() < off * spin
        assert (np.abs(error[:, 3:6]) < found.sd[:, 3:6]).all()
        known = np.linalg.norm(found.sd[:, 9:], axis=1)  # along one axis the fits may agree by chance
        assert (np.linalg.norm(error[:, 9:], axis=1) < known).all()


def test_a_turning_is_not_followed_across_a_gap():
    """20 rad/s: 3.6 rad in nine intervals, which might be -2.7."""
    body = mujoco.MjModel.from_xml_string(TUMBLING)
    start = model_initial_states(body, 1).states
    start.qvel[:, 3:] = [12.0, 12.0, 11.0]
    done = Engine(body, 1).rollout(initial=start, controls=np.zeros((1, 1000, 0)), keep=Keep(states=True))
    kept = np.r_[0:200:20, 380:1000:20]
    motion = (0.001 * kept, *(a[0, kept] for a in (done.sensors, done.qpos, done.qvel)))
    found, error = estimate(body, motion, ("how",), noise=1e-3, first=np.array([7, 9, 10, 12]))
    assert np.linalg.norm(error[:, 9:], axis=1).max() < 0.1 * 20
    assert (np.abs(error[:, 9:]) < found.sd[:, 9:]).all()


def test_the_clock_begins_where_the_log_does(model, motion):
    time, *rest = motion
    found, _ = estimate(model, (time + 1234.5, *rest), ALL, noise=1e-3, first=np.array([0, 50]))
    np.testing.assert_array_equal(found.states.time, time[[0, 50]] + 1234.5)


@pytest.mark.parametrize("samples", [2, 5])
def test_too_few_samples_to_differentiate_leave_the_velocity_open(model, motion, samples):
    short = tuple(part[:samples] for part in motion)
    found, _ = estimate(model, short, ("x",), noise=1e-3, first=np.array([0]))
    assert found.states.qvel[0, 0] == 0
    assert found.sd[0, model.nv] >= 10


# --- gyroscopes ---

GYROS = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="flyer" pos="0 0 5" euler="10 20 30">
      <freejoint/>
      <geom type="box" size=".3 .2 .1" mass="1"/>
      <site name="own" euler="40 -20 70"/>
      <body name="rack" euler="25 50 -10">
        <geom type="box" size=".1 .05 .05" pos=".3 0 0" mass=".2"/>
        <site name="welded" euler="0 90 15"/>
        <body><joint name="nod" axis="0 1 0"/><geom size=".05" mass=".1"/><site name="nodding"/></body>
      </body>
    </body>
    <body name="trolley" euler="0 0 35">
      <joint name="along" type="slide" axis="1 0 0" stiffness="40"/>
      <geom size=".1" mass="1"/>
      <body name="pendulum" pos="0 0 2" euler="15 0 0">
        <joint name="ball" type="ball"/>
        <geom type="capsule" fromto="0 0 0 .1 0 -.5" size=".02" mass="1"/>
        <site name="hanging" pos="0 0 -.5" euler="70 10 0"/>
      </body>
    </body>
    <body pos="5 0 0">
      <joint name="pan" axis="0 0 1"/>
      <geom size=".1" mass="1"/>
      <body>
        <joint name="carried" type="ball"/>
        <geom type="capsule" fromto="0 0 0 .1 0 -.5" size=".02" mass="1"/>
        <site name="panned"/>
      </body>
    </body>
  </worldbody>
  <sensor>
    <gyro name="own" site="own"/> <gyro name="welded" site="welded"/> <gyro name="nodding" site="nodding"/>
    <gyro name="hanging" site="hanging"/> <gyro name="panned" site="panned"/>
    <framequat name="how" objtype="xbody" objname="flyer"/>
    <framequat name="rack" objtype="body" objname="rack"/> <framequat name="swung" objtype="xbody" objname="pendulum"/>
    <framequat name="imu" objtype="site" objname="hanging"/> <framequat name="nods" objtype="site" objname="nodding"/>
    <framequat name="seen" objtype="xbody" objname="pendulum" reftype="xbody" refname="flyer"/>
  </sensor>
</mujoco>
"""


@pytest.fixture(scope="module")
def gyros() -> tuple[mujoco.MjModel, tuple]:
    """Gyroscopes on all that turns, and a motion of it as `motion` has it."""
    model = mujoco.MjModel.from_xml_string(GYROS)
    speed = np.random.default_rng(5).normal(0, 2.0, (1, model.nv))
    start = InitialStates(model.qpos0[None] + 0.0, speed, np.zeros((1, 0)), np.zeros(1))
    done = Engine(model, 1).rollout(initial=start, controls=np.zeros((1, STEPS, 0)), keep=Keep(states=True))
    return model, (model.opt.timestep * np.arange(STEPS), done.sensors[0], done.qpos[0], done.qvel[0])


@pytest.mark.parametrize(("site", "turning"), [("own", 3), ("welded", 3), ("hanging", 8)])
def test_a_gyroscope_says_how_fast_its_body_turns(gyros, site, turning):
    """In the frame of the joint's body, however the site is turned in it."""
    model, motion = gyros
    found, error = estimate(model, motion, (site,), noise=1e-3)
    read = model.nv + np.arange(turning, turning + 3)
    assert np.abs(error[:, read]).max() < 2e-3
    assert (np.abs(error[:, read]) < found.sd[:, read]).all()
    assert np.flatnonzero(found.sd.any(axis=0)).tolist() == read.tolist()


@pytest.mark.parametrize("site", ["nodding", "panned"])
def test_a_gyroscope_that_several_joints_turn_says_nothing_of_one(gyros, site):
    model, motion = gyros
    assert not estimate(model, motion, (site,), noise=1e-3)[0].sd.any()


def test_one_axis_of_a_gyroscope_that_is_askew_is_no_coordinates(gyros):
    model, _ = gyros
    assert sources_of(model, columns(model, "own")[:1]) == []


@pytest.mark.parametrize(
    ("name", "values"), [("sensor-frame-rotation", [0.2, -0.1, 0.15]), ("sensor-delay", [0.05])]
)
def test_a_corrected_gyroscope_moves_the_turning_and_not_the_attitude_beside_it(gyros, name, values):
    model, (time, sensors, qpos, qvel) = gyros
    nv, interval, first = model.nv, time[1] - time[0], np.array([80, 180, 280])
    effect, values = effects.REGISTRY.get(name)(model, "own"), np.tile(values, (3, 1))
    seen = effect.measure(sensors[None], values[:1], interval)[0]
    found, before = estimate(model, (time, seen, qpos, qvel), ("own", "how"), noise=0.0, first=first)
    late = effect.lateness(values) * np.ones((3, model.nsensordata))
    true = effect.true_motion(found.reported.at(late.max() - late), values)
    initial = shift(model, found.states, found.reported.initial_change(true, 2 * nv))
    at = first - round(late.max() / interval)
    error = np.abs(initial.qvel - qvel[at])[:, 3:6]
    np.testing.assert_allclose(initial.qpos[:, 3:7], qpos[at, 3:7], atol=1e-4)
    assert error.max() < 2e-3 < 0.02 < np.abs(before[:, nv + 3 : nv + 6]).max()


# --- frames that slides alone carry ---

# A plate in a plane, askew in the room, that a camera follows by a marker where its hinge is
PLATE = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body pos=".3 -.2 .1" euler="20 10 30">
      <body name="plate" pos=".05 .04 0">
        <joint name="x" type="slide" axis="1 0 0" stiffness="40"/>
        <joint name="y" type="slide" axis="1 4 0" stiffness="30" ref=".2"/>
        <joint name="turn" axis="0 0 1" pos=".1 0 0" stiffness="1"/>
        <geom type="box" size=".1 .1 .01" mass="1"/>
        <site name="marker" pos=".1 0 0"/><site name="corner" pos=".1 .1 0"/>
      </body>
    </body>
  </worldbody>
  <sensor>
    <framepos name="marker" objtype="site" objname="marker"/><framepos name="corner" objtype="site" objname="corner"/>
    <jointpos name="turn" joint="turn"/>
  </sensor>
</mujoco>
"""


def test_a_camera_gives_the_slides_that_carry_a_point():
    plate = mujoco.MjModel.from_xml_string(PLATE)
    begin = InitialStates(
        np.array([[0.1, 0.25, 0.3]]), np.array([[0.2, -0.4, 1.0]]), np.zeros((1, 0)), np.zeros(1)
    )
    done = Engine(plate, 1).rollout(initial=begin, controls=np.zeros((1, 600, 0)), keep=Keep(states=True))
    data = columns(plate, "turn", "marker")
    assert measures_every_coordinate(plate, data)
    outputs, first = done.sensors[0][:, data], np.arange(100, 500, 50)
    for source in sources_of(plate, data):
        np.testing.assert_allclose(
            source.of(outputs[:, source.columns]), done.qpos[0][:, source.qpos], atol=1e-12
        )
    found = estimated_initial_states(
        plate,
        data,
        Places(Log(0.002 * np.arange(600), outputs, [slice(0, 600)]), first, np.zeros(len(first), dtype=int)),
        np.full(4, 1e-5),
    )
    np.testing.assert_allclose(found.states.qpos, done.qpos[0, first], atol=1e-4)
    np.testing.assert_allclose(found.states.qvel, done.qvel[0, first], atol=5e-3)
    turned = columns(plate, "turn", "corner")
    assert unmeasured_joints(plate, turned) == ["x", "y"], "the hinge moves the corner, too"


# --- attitudes of frames that a joint carries ---


@pytest.mark.parametrize(("sensor", "turning"), [("rack", 3), ("swung", 8), ("imu", 8)])
def test_a_frame_says_how_the_joint_that_carries_it_is_turned(gyros, sensor, turning):
    """However the frame is turned in the body of the joint, and that body in the world."""
    model, motion = gyros
    found, error = estimate(model, motion, (sensor,), noise=1e-3)
    read = np.concatenate([turning + np.arange(3), model.nv + turning + np.arange(3)])
    assert np.abs(error[:, read[:3]]).max() < 3e-3
    assert (np.abs(error[:, read]) < found.sd[:, read]).all()
    assert np.flatnonzero(found.sd.any(axis=0)).tolist() == read.tolist()


@pytest.mark.parametrize("sensor", ["nods", "seen"])
def test_a_frame_that_more_than_a_joint_turns_says_nothing_of_it(gyros, sensor):
    model, motion = gyros
    assert not estimate(model, motion, (sensor,), noise=1e-3)[0].sd.any()


def test_a_corrected_attitude_of_a_carried_frame_moves_the_joint(gyros):
    model, (time, sensors, qpos, qvel) = gyros
    nv, first, values = model.nv, np.array([80, 180, 280]), np.tile([0.2, -0.1, 0.15], (3, 1))
    effect = effects.REGISTRY.get("sensor-mount-rotation")(model, "imu")
    seen = effect.measure(sensors[None], values[:1], time[1] - time[0])[0]
    found, _ = estimate(model, (time, seen, qpos, qvel), ("imu",), noise=0.0, first=first)
    true = effect.true_motion(found.reported.derivatives, values)
    initial = shift(model, found.states, found.reported.initial_change(true, 2 * nv))
    np.testing.assert_allclose(initial.qpos[:, 9:13], qpos[first, 9:13], atol=1e-4)
    assert np.abs(initial.qvel - qvel[first])[:, 8:11].max() < 2e-3


# --- what no output measures ---


def test_unmeasured_coordinates_stay_at_the_models_start(model, motion):
    found, _ = estimate(model, motion, ("x",), noise=1e-3)
    np.testing.assert_array_equal(found.states.qpos[:, 1:], np.tile(model.qpos0[1:], (len(found.sd), 1)))
    assert (found.sd[:, 1 : model.nv] == 0).all()
    assert (found.sd[:, 0] > 0).all()
    assert (found.sd[:, model.nv] > 0).all()


def test_unmeasured_coordinates_may_be_off_by_more_than_they_move(model, motion):
    _, _, qpos, qvel = motion
    first = np.array([0, 100])
    whole = Rollouts(np.zeros(0), np.zeros(1), qpos[None], qvel[None], np.zeros((1, len(qpos), 0)))
    believed = from_episodes(model, whole, window_episode=np.zeros(2, dtype=int), window_step=first)
    found, error = estimate(model, motion, ("x",), noise=1e-3, first=first, unmeasured=believed)
    assert np.abs(error[:, 1 : model.nv]).max() < 1e-12  # they come from the simulation: exact here
    np.testing.assert_allclose(found.sd[0, 1 : model.nv], believed.sd[0, 1 : model.nv])
    assert believed.sd[0, 0] == pytest.approx(3 * qpos[:, 0].std())
    resting = from_episodes(
        model,
        Rollouts(
            np.zeros(0),
            np.zeros(1),
            np.repeat(qpos[None, :1], 5, axis=1),
            np.zeros((1, 5, model.nv)),
            np.zeros((1, 5, 0)),
        ),
        window_episode=np.array([0]),
        window_step=np.array([2]),
    )
    assert (resting.sd == 0).all()


def test_which_outputs_measure_every_coordinate(model):
    assert measures_every_coordinate(model, columns(model, *ALL))
    assert not measures_every_coordinate(model, columns(model, "x", "ball", "where"))
    assert not measures_every_coordinate(model, columns(model, "v", "ball", "where", "how"))


# A differential gear behind an elevator: the two shafts turn with all three joints, and only the first has a sensor.
DIFFERENTIAL = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0"/>
  <default><joint damping="0.05" stiffness="2"/></default>
  <worldbody>
    <body><joint name="lift" type="slide" axis="0 0 1"/><geom size=".1" mass="1"/>
      <body><joint name="pitch" axis="0 1 0"/><geom size=".05" pos=".1 0 0" mass=".5"/>
        <body><joint name="roll" axis="1 0 0"/><geom size=".05" pos=".1 .03 0" mass=".3"/></body></body></body>
  </worldbody>
  <tendon>
    <fixed name="a"><joint joint="pitch" coef="1"/><joint joint="roll" coef=".8"/><joint joint="lift" coef="3"/></fixed>
    <fixed name="b"><joint joint="pitch" coef="1"/><joint joint="roll" coef="-.8"/></fixed>
  </tendon>
  <actuator><motor name="m" tendon="b" gear="-20"/><motor name="hoist" joint="lift" gear="4"/></actuator>
  <sensor>
    <jointpos name="lift" joint="lift"/><tendonpos name="a" tendon="a"/><actuatorpos name="m" actuator="m"/>
    <actuatorpos name="hoist" actuator="hoist"/>
    <actuatorvel name="turning" actuator="m"/><tendonvel name="running" tendon="a"/><jointvel name="up" joint="lift"/>
  </sensor>
</mujoco>
"""


@pytest.mark.parametrize(
    "names", [("lift", "a", "m"), ("m", "hoist", "a"), ("up", "turning", "a", "running", "lift", "m")]
)
def test_gears_and_tendons_are_solved_for_the_joints_they_move(names):
    gears = mujoco.MjModel.from_xml_string(DIFFERENTIAL)
    random = np.random.default_rng(5)
    begin = InitialStates(
        random.normal(0, 0.3, (1, 3)), random.normal(0, 1.0, (1, 3)), np.zeros((1, 0)), np.zeros(1)
    )
    done = Engine(gears, 1).rollout(initial=begin, controls=np.zeros((1, 1000, 2)), keep=Keep(states=True))
    data = columns(gears, *names)
    assert measures_every_coordinate(gears, data)
    assert unmeasured_joints(gears, data) == []
    noise = np.array([20e-4 if name in ("m", "turning") else 1e-4 for name in names])
    outputs = done.sensors[0][:, data] + noise * random.standard_normal((1000, len(data)))
    first = np.arange(100, 900, 50)
    found = estimated_initial_states(
        gears,
        data,
        Places(
            Log(0.001 * np.arange(1000), outputs, [slice(0, 1000)]),
            first,
            np.zeros(len(first), dtype=int),
        ),
        noise,
    )
    off = np.hstack([found.states.qpos - done.qpos[0, first], found.states.qvel - done.qvel[0, first]])
    assert (found.sd[:, :3] < 20 * 1e-4).all() and (found.sd[:, 3:] < 0.5).all()
    assert (np.abs(off) < found.sd).all()
    # what an effect of a sensor changes in its numbers changes the initial states that were read off them
    derivatives = found.reported.derivatives.copy()
    true = derivatives.copy()
    scale = data[names.index("m")]
    true[:, :, scale] *= 1.1
    change = found.reported.initial_change(true, 6)
    share = -0.1 * derivatives[:, 0, scale] / 20
    np.testing.assert_allclose(change[:, :3], share[:, None] * [0, 0.5, -0.5 / 0.8], atol=1e-12)


@pytest.mark.parametrize(
    ("names", "left"),
    [
        (("m",), ["lift", "pitch", "roll"]),
        (("lift", "a"), ["pitch", "roll"]),
        (("up", "a", "m"), ["lift", "pitch", "roll"]),
    ],
)
def test_what_tendons_over_several_joints_leave_open_is_not_measured(names, left):
    gears = mujoco.MjModel.from_xml_string(DIFFERENTIAL)
    assert unmeasured_joints(gears, columns(gears, *names)) == left


def test_the_models_start_is_its_first_keyframe():
    keyed = mujoco.MjModel.from_xml_string(
        XML.replace("</mujoco>", '<keyframe><key qvel="1 2 3 4 5 6 7 8 9 10"/></keyframe></mujoco>')
    )
    found = model_initial_states(keyed, 3)
    assert found.states.qvel.tolist() == [[1, 2, 3, 4, 5, 6, 7, 8, 9, 10]] * 3
    assert (found.sd == 0).all()


def test_shift_moves_quaternions_by_a_rotation(model):
    start = model_initial_states(model, 2).states
    corrections = np.zeros((2, 2 * model.nv))
    corrections[1, [0, 3, model.nv]] = [0.25, np.pi / 2, -1.0]
    moved = shift(model, start, corrections)
    np.testing.assert_array_equal(moved.qpos[0], start.qpos[0])
    assert moved.qpos[1, 0] == 0.25
    np.testing.assert_allclose(moved.qpos[1, 1:5], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], atol=1e-12)
    assert moved.qvel[1, 0] == start.qvel[1, 0] - 1


def test_offsets_between_starts_lead_from_one_to_the_other(model):
    begin = model_initial_states(model, 3).states
    end = shift(model, begin, np.random.default_rng(5).normal(scale=0.4, size=(3, 2 * model.nv + model.na)))
    there = shift(model, begin, corrections_between(model, begin, end))
    for name in ("qpos", "qvel", "act"):
        assert getattr(there, name) == pytest.approx(getattr(end, name), abs=1e-12)


def test_a_corrected_report_moves_the_coordinates_that_were_read_off_it(model, motion):
    """Position off its own sensor; velocity off its own where there is one, and off the slope where there is none."""
    nv = model.nv
    for names, moves_velocity in ((("x",), True), (("x", "v"), False)):
        found, _ = estimate(model, motion, names, noise=1e-4)
        reported = found.reported
        x, v = model.sensor("x").adr[0], model.sensor("v").adr[0]
        true = reported.derivatives.copy()
        true[:, 0, x] += 0.5
        true[:, 1, x] += 0.25
        true[:, 0, v] += 0.125
        change = reported.initial_change(true, 2 * nv)
        expected = np.zeros((len(change), 2 * nv))
        expected[:, 0] = 0.5
        expected[:, nv] = 0.25 if moves_velocity else 0.125
        np.testing.assert_allclose(change, expected)
        assert not reported.initial_change(reported.derivatives, 2 * nv).any()
        finer = reported.initial_change(reported.derivatives, 2 * nv, substeps=4)
        lag_less = 0.75 * 0.5 * model.opt.timestep  # a quarter of the step lags a quarter as much
        expected[:, 0] = 0.0
        expected[:, nv] = lag_less * reported.derivatives[:, 2, x] if moves_velocity else 0.0
        np.testing.assert_allclose(finer[:, : nv + 1], expected[:, : nv + 1], atol=1e-15)
    assert found.rows(slice(2)).reported.derivatives.shape[0] == 2


@pytest.mark.parametrize("sensor", ["ball", "how"])
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("sensor-frame-rotation", [0.2, -0.1, 0.15]),
        ("sensor-mount-rotation", [0.2, -0.1, 0.15]),
        ("sensor-delay", [0.02]),
    ],
)
def test_a_corrected_attitude_moves_orientation_and_turning(model, motion, sensor, name, values):
    """Initial states that were read off an attitude that is reported turned, or late, come to where they were."""
    time, sensors, qpos, qvel = motion
    nv, interval, first = model.nv, time[1] - time[0], np.array([40, 90, 140])
    effect, values = effects.REGISTRY.get(name)(model, sensor), np.tile(values, (3, 1))
    seen = effect.measure(sensors[None], values[:1], interval)[0]
    found, before = estimate(model, (time, seen, qpos, qvel), ALL, noise=0.0, first=first)
    # initial states are of a time as much earlier as this sensor is late, when the others reported other numbers
    late = effect.lateness(values) * np.ones((3, model.nsensordata))
    true = effect.true_motion(found.reported.at(late.max() - late), values)
    initial = shift(model, found.states, found.reported.initial_change(true, 2 * nv))
    at = first - round(late.max() / interval)
    error = initial.qvel - qvel[at]
    for row, step in enumerate(at):
        apart = np.zeros(nv)
        mujoco.mj_differentiatePos(model, apart, 1.0, qpos[step], initial.qpos[row])
        error[row] = np.maximum(np.abs(error[row]), np.abs(apart))
    assert error.max() < 2e-3 < 0.02 < np.abs(before).max()
    assert not found.reported.initial_change(found.reported.derivatives, 2 * nv).any()


def test_the_path_before_a_start_is_that_of_the_log(model, motion):
    """A carriage on a spring goes round at 6 rad/s: a quarter of a second is a radian and a half."""
    time, sensors, *_ = motion
    first = np.array([0, 150, 240])
    found, _ = estimate(model, motion, ("x",), noise=1e-5, first=first)
    x = model.sensor("x").adr[0]
    for before in (0.0, 0.012, 0.1, 0.248):
        derivatives = found.reported.at(np.full((3, model.nsensordata), before))
        there = sensors[first[1:] - round(before / (time[1] - time[0])), x]
        np.testing.assert_allclose(derivatives[1:, 0, x], there, atol=1e-4)
    # before the log nothing is known: it is taken to have been evenly accelerated
    value, slope, curvature = found.reported.derivatives[0, :, x]
    even = value - 0.1 * slope + 0.1**2 / 2 * curvature
    assert found.reported.at(np.full((3, model.nsensordata), 0.1))[0, 0, x] == pytest.approx(even)
