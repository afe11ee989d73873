"""The contract of an effect, run over the whole catalogue, and the physics of those that need a reference."""

from __future__ import annotations

from dataclasses import replace
from inspect import isclass
from pathlib import Path

import mujoco
import numpy as np
import pytest
from machines import (
    ARM,
    BALL,
    MACHINES,
    NAMES,
    away,
    build,
    controls,
    is_shape,
    machine,
    placed,
    plain,
    run,
    start,
)
from scipy.linalg import expm

from capture_cli.errors import ModelError
from capture_cli.estimate.initial_states.from_outputs import model_initial_states
from capture_cli.log.arrays import Log
from capture_cli.log.input_sequences import EVENLY, HELD, CachedSequences
from capture_cli.log.windows import SETTINGS as WINDOWS
from capture_cli.log.windows import cut
from capture_cli.model import effects
from capture_cli.model.effects._actuator_effect import ActuatorEffect
from capture_cli.model.effects._joint_force import inertia_felt
from capture_cli.model.effects._kernel import bound
from capture_cli.model.effects._vibration import Shaken
from capture_cli.model.effects.base import (
    GLOBAL,
    PLACES,
    Driven,
    Effect,
    JointMotion,
    Recordings,
    Reports,
    SeenLog,
)
from capture_cli.model.fields import ModelFields
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks import load_task
from capture_cli.simulate import engine as engine_module
from capture_cli.simulate.engine import Engine, Keep
from capture_cli.simulate.simulator import Simulator

SLIDER = Path(__file__).parents[1] / "benchmarks" / "machines" / "slider" / "task.toml"

PAGE = (Path(__file__).parents[1] / "docs" / "effects.md").read_text(encoding="utf-8")
# Effects that have a size; the others are there, or they are not.
SIZED = [n for n in NAMES if placed(n)[0][1].parameters]

# -- the contract, for every effect


@pytest.mark.smoke
@pytest.mark.parametrize("name", NAMES)
def test_an_effect_says_what_it_is_and_where_it_sits(name):
    effect = effects.REGISTRY.get(name)
    assert effect.place in PLACES and effect.summary and effect.where
    assert effect.reports_late == (effect.lateness is not Effect.lateness)
    assert placed(name), "no test machine has a site for it"
    for _, instance in placed(name):
        names = [p.name for p in instance.parameters]
        assert len(set(names)) == len(names)
        assert not names or set(names) - set(effect.shapes), "no amplitude"
        assert not set(vars(instance)) & set(dir(effect)) - {
            "seen",
            "states",
            "substeps",
            "window",
            "longest",
            "logged",
        }, "hides what all have"
        for parameter in instance.parameters:
            assert parameter.unit and parameter.low <= parameter.nominal <= parameter.high


@pytest.mark.smoke
@pytest.mark.parametrize("name", NAMES)
def test_at_null_it_is_the_plain_model_away_from_it_outputs_move_and_at_its_bounds_they_are_finite(name):
    """At null whatever the shapes; away from it every parameter moves an output somewhere."""
    rng = np.random.default_rng(0)
    unmoved = {p.name for _, effect in placed(name) for p in effect.parameters}
    for where, effect in placed(name):
        space, shape = effect.space, is_shape(effect)
        null = np.where(shape, space.low + rng.random((3, len(space))) * space.span, space.nominal)
        base = away(effect, 0.5)
        # without each amplitude in turn, and with another value of each shape
        one_less = np.repeat(base[None], len(space), axis=0)
        end = np.where(base > space.low, space.low, space.high)
        np.fill_diagonal(one_less, np.where(shape, 0.5 * (end + base), space.nominal))
        values = np.vstack([null, space.low, space.high, base, one_less])
        sensors, diverged = run(machine(where), (effect, values), count=len(values))
        assert np.isfinite(sensors[3:5]).all() and not diverged[3:5].any(), (where, effect.site)
        if name in SIZED:
            assert np.array_equal(sensors[:3], np.repeat(plain(where), 3, axis=0)), (where, effect.site)
        moved = np.abs(sensors[6:] - sensors[5]).max(axis=(1, 2)) > 1e-9
        unmoved -= {p.name for p, m in zip(effect.parameters, moved, strict=True) if m}
    assert not unmoved


@pytest.mark.parametrize("name", NAMES)
def test_a_batch_in_chunks_is_its_simulations_one_by_one(name, monkeypatch):
    where, effect = placed(name)[-1]
    values = np.stack([away(effect, part) for part in (0.1, 0.4, 0.7)])
    alone = np.concatenate([run(machine(where), (effect, row[None]))[0] for row in values])
    monkeypatch.setattr(engine_module, "CHUNK_SIMULATIONS", 2)
    batch, _ = run(machine(where), (effect, values), count=3)
    assert np.array_equal(batch, alone)


FORCES = [n for n in NAMES if effects.REGISTRY.get(n).place == "force"]


@pytest.mark.parametrize("name", [n for n in FORCES if effects.REGISTRY.get(n).reads_acceleration])
def test_forces_act_as_one_in_whatever_order_they_are_named(name):
    """As a simulation begins there is an acceleration to follow: that under all forces that do not follow it."""
    matters = False
    for where, effect in placed(name)[:2]:
        # an encoder on the motor moves the start as well, and whoever comes after it begins there
        here = [o for n in FORCES if n != name for w, o in placed(n)[:3] if w == where and "+" not in o.site]
        tape = controls(machine(where), 1)[:, :50]
        alone, _ = run(machine(where), (effect, away(effect, 0.2)[None]), tape=tape)
        for other in here if "+" not in effect.site else []:
            pair = [(e, away(e, 0.2)[None]) for e in (effect, other)]
            (one, _), (swapped, _) = (run(machine(where), *p, tape=tape) for p in (pair, pair[::-1]))
            np.testing.assert_allclose(one, swapped, atol=1e-9, err_msg=f"{where}: {other}")
            matters |= np.abs(one - alone).max() > 1e-4
    assert matters


@pytest.mark.parametrize("name", FORCES)
def test_a_force_goes_on_from_what_it_remembers(name):
    """From the state of the model and what its kernel keeps, a step ends where it does in the midst of a simulation."""
    effect_type = effects.REGISTRY.get(name)
    assert bool(effect_type.kernel_keeps) == isclass(getattr(effect_type, "kernel", None))
    for where, effect in placed(name)[:2]:
        model, values = machine(where), away(effect, 0.3)[None]
        fields, tape, initial = ModelFields(model, 1), controls(model, 1)[:, :60], start(model, 1)
        effect.write(fields, values)
        engine = Engine(model, 1)

        def force(effect=effect, values=values, step=model.opt.timestep):
            return [effect.force(values, step)]

        keep = Keep(states=True, remembered=True)
        whole = engine.rollout(initial, tape, fields=fields, forces=force(), keep=keep)
        still = engine.rollout(initial, tape, keep=keep)
        for at in (20, 58):
            qpos, qvel, act = (v[:, at] for v in (whole.qpos, whole.qvel, whole.act))
            begins = InitialStates(qpos, qvel, act, initial.time + at * model.opt.timestep)
            step = engine.single_steps(begins, tape[:, at][:, None], fields, force(), whole.remembered[:, at])
            acts = np.abs(whole.qvel[:, at + 1] - still.qvel[:, at + 1]).max()
            np.testing.assert_allclose(step.ends.qvel, whole.qvel[:, at + 1], atol=0.05 * acts + 1e-9)
            kept = whole.remembered[:, at + 1]
            np.testing.assert_allclose(step.remembered, kept, atol=0.05 * np.abs(kept).max(initial=0) + 1e-9)


MEASUREMENTS = [n for n in NAMES if effects.REGISTRY.get(n).place == "measurement"]


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_a_true_motion_is_reported_as_it_was_seen(name):
    """Even motions, which every kernel continues exactly: what `true_motion` makes of a report gives that report."""
    rng = np.random.default_rng(1)
    for where, effect in placed(name):
        model, timestep = machine(where), machine(where).opt.timestep
        derivatives = rng.normal(size=(4, 3, model.nsensordata)) * np.array([1.0, 1.0, 0.0])[:, None]
        values = np.stack([away(effect, part) for part in (0.1, 0.4, 0.7, 1.0)])
        true = effect.true_motion(derivatives, values)
        time = timestep * np.arange(5)
        value = true[:, 0] + true[:, 1] * effect.lateness(
            values
        )  # what is reported at a time was so before it
        series = value[:, None] + true[:, 1:2] * time[:, None] + true[:, 2:3] * np.square(time)[:, None] / 2
        seen = effect.measure(series, values, timestep)
        between = (
            np.diff(seen, axis=1)[:, 1:] / timestep
        )  # at 1.5, 2.5 and 3.5 steps; a parabola through them at 0:
        slope = np.tensordot(between, [4.375, -5.25, 1.875], axes=(1, 0))
        if name in ("sensor-quantisation", "sensor-saturation"):
            assert np.array_equal(true, derivatives)  # what is rounded or cut off cannot be undone
            continue
        np.testing.assert_allclose(seen[:, 0], derivatives[:, 0], atol=1e-9)
        # of a cubic reading a parabola through three of its slopes is not the whole
        np.testing.assert_allclose(
            slope, derivatives[:, 1], atol=1e-5 if name == "sensor-nonlinearity" else 1e-7
        )
        null = np.repeat(effect.space.nominal[None], 4, axis=0)
        assert np.array_equal(effect.true_motion(derivatives, null), derivatives)


@pytest.mark.parametrize("name", NAMES)
def test_what_it_is_given_stays_as_it_is(name):
    where, effect = placed(name)[0]
    values = away(effect, 0.5)[None]
    tape, sensors = controls(machine(where), 1), plain(where)
    before = tape.copy(), sensors.copy()
    effect.drive(tape, values, 0.002)
    effect.measure(sensors, values, 0.002)
    assert np.array_equal(tape, before[0]) and np.array_equal(sensors, before[1])


@pytest.mark.parametrize("where", MACHINES)
@pytest.mark.parametrize("forced", [False, True])
def test_a_finer_step_is_that_of_a_model_with_it(where, forced):
    model = machine(where)
    for site, substeps in (("half", 2), ("eighth", 8)):
        finer = build(MACHINES[where])
        finer.opt.timestep /= substeps
        effect = effects.REGISTRY.get("finer-time-step")(model, site)
        tape = controls(model, 1)

        def outputs(model, tape, effect=None):
            fields = ModelFields(model, 1)
            if effect:
                effect.write(fields, np.zeros((1, 0)))
            rollouts = Engine(model, 1).rollout(
                initial=start(model, 1),
                controls=tape,
                fields=fields,
                forces=[lambda world: None] if forced else [],
                keep=Keep(states=True),
            )
            return np.concatenate([rollouts.sensors, rollouts.qpos, rollouts.qvel], axis=2)

        expected = outputs(finer, np.repeat(tape, substeps, axis=1))[:, ::substeps]
        found = outputs(model, tape, effect)
        assert np.array_equal(found, expected)
        assert where == "ball" or not np.array_equal(found, outputs(model, tape))


@pytest.mark.parametrize("name", NAMES)
def test_states_are_said_in_the_docs(name):
    said = effects.REGISTRY.get(name).states_mean
    for _, effect in placed(name):
        for state in effect.states:
            # "drive before", "held 2", "wound"
            assert state.split()[0 if state[-1].isdigit() else -1] in said
    row = next((row for row in PAGE.splitlines() if said and row.endswith(f" | {said} |")), "")
    assert (f"`{name}`" in row) == bool(said)


def test_shapes_are_spread_over_their_range_with_null_amplitudes():
    effect = effects.REGISTRY.get("stribeck-friction")(machine("slider"), "x")
    grid = effect.shape_grid(4)
    assert grid.shape == (4, 2) and not grid[:, 0].any()
    assert np.allclose(np.diff(np.log(grid[:, 1])), np.log(effect.space.high[1] / effect.space.low[1]) / 4)


def test_a_site_without_a_name_is_called_by_its_number_and_a_wrong_one_is_refused():
    force = effects.REGISTRY.get("constant-force")
    assert force.sites(machine("ball")) == ["ball", "#1"]
    assert force(machine("ball"), "#1").number == 1
    with pytest.raises(ModelError, match="cannot sit at 'elbw'") as refused:
        effects.REGISTRY.get("coulomb-friction")(machine("arm"), "elbw")
    assert "elbow" in refused.value.cure
    with pytest.raises(ModelError, match="no place"):
        effects.REGISTRY.get("magnus-lift")(machine("arm"), GLOBAL)


# -- physics


DISSIPATIVE = [
    "coulomb-friction",
    "cubic-drag",
    "direction-dependent-coulomb",
    "direction-dependent-viscous",
    "medium-density",
    "medium-viscosity",
    "position-dependent-friction",
    "quadratic-drag",
    "stribeck-friction",
    "viscous-damping",
]


@pytest.mark.parametrize("name", DISSIPATIVE)
def test_friction_takes_energy_and_never_gives_any(name):
    model, effect = machine("cart_pole"), effects.REGISTRY.get(name)
    effect = effect(model, "pole" if "pole" in effect.sites(model) else GLOBAL)
    null, some = effect.space.nominal, away(effect, 0.3)
    if name == "stribeck-friction":
        null[1] = some[1] = 4.0  # rad/s: as fast as the pole falls
    values = np.clip([null, some, 2 * null - some], effect.space.low, effect.space.high)
    sensors, _ = run(model, (effect, values), count=3, tape=np.zeros((3, 300, 1)))
    energy = sensors[..., 2:4].sum(axis=-1)
    assert (np.diff(energy, axis=1) < 1e-6).all()
    assert energy[1:, -1].min() < energy[0, -1] - 0.01


@pytest.mark.parametrize(("load", "squeeze"), [(1.0, 2.5), (0.0, 1.5)])
def test_load_dependent_friction_is_the_coefficient_times_the_squeeze(load, squeeze):
    model = build("""
        <mujoco><option timestep="0.002"/><worldbody><body>
          <joint name="z" type="slide" axis="0 0 1"/><geom size=".1" mass="2" contype="0" conaffinity="0"/>
        </body></worldbody>
        <actuator><motor joint="z"/></actuator><sensor><jointvel joint="z"/></sensor></mujoco>""")
    effect = effects.REGISTRY.get("load-dependent-friction")(model, "z")
    weight = 2 * 9.81
    lifted = np.full((1, 200, 1), 1.5 * weight)
    speed = run(model, (effect, np.array([[0.1, load]])), tape=lifted)[0][0, -1, 0]
    assert speed == pytest.approx(
        (1.5 * weight - weight - 0.1 * squeeze * weight) / 2 * 0.002 * 199, rel=0.01
    )
    held = run(model, (effect, np.array([[0.6, load]])), tape=lifted / 1.5 * 1.2)[0][0, -1, 0]
    assert abs(held) < 0.02  # MuJoCo's friction creeps; free of it, the speed would be 0.8 m/s


def test_the_inertia_that_a_joint_feels_is_that_of_all_it_moves():
    model = machine("arm")
    data = mujoco.MjData(model)
    data.qpos[:] = np.linspace(0.4, 1.3, model.nq)
    mujoco.mj_forward(model, data)
    columns = np.zeros((model.nv, model.nv))
    mujoco.mj_solveM(model, data, columns, np.eye(model.nv))
    for dof in range(model.nv):
        felt = inertia_felt(model, data.qLD[None], data.qLDiagInv[None], dof)
        assert felt == pytest.approx(1 / columns[dof, dof])


def test_friction_grows_with_the_load_of_a_joint_that_a_cable_drives():
    effect = effects.REGISTRY.get("load-dependent-friction")
    finger = build("""
        <mujoco><worldbody><body><joint name="mcp" axis="0 1 0"/><geom size=".1" mass="1"/>
          <body pos="1 0 0"><joint name="pip" axis="0 1 0"/><geom size=".1" mass="1"/>
            <body pos="1 0 0"><joint name="free" axis="0 1 0"/><geom size=".1" mass="1"/></body>
          </body></body></worldbody>
        <tendon><fixed name="cable"><joint joint="mcp" coef=".009"/><joint joint="pip" coef=".007"/></fixed></tendon>
        <actuator><motor tendon="cable"/></actuator><sensor><jointvel joint="pip"/></sensor></mujoco>""")
    assert effect.sites(finger) == ["mcp", "pip"]


def test_friction_that_varies_not_at_all_is_native_frictionloss():
    model = machine("cart_pole")
    patch = effects.REGISTRY.get("position-dependent-friction")(model, "cart")
    native = effects.REGISTRY.get("coulomb-friction")(model, "cart")
    everywhere = np.array([[0.4, 0.0, 1e9]])
    # two of them add up, and what one step added is gone at the next
    varied, _ = run(model, (patch, everywhere), (patch, 2 * everywhere))
    assert np.array_equal(varied, run(model, (native, np.array([[0.4 + 0.8]])))[0])


def test_direction_dependent_friction_is_the_models_own_in_each_direction():
    effect = effects.REGISTRY.get("direction-dependent-viscous")(machine("slider"), "x")
    native = effects.REGISTRY.get("viscous-damping")(machine("slider"), "x")
    tape = np.zeros((1, 100, 1))
    for push, asymmetry, damping in ((2.0, 1.5, 1.5), (-2.0, 1.5, -1.5), (-2.0, 9.0, -2.0)):
        tape[...] = push
        begin = InitialStates(np.zeros((1, 1)), np.full((1, 1), push / 10), np.zeros((1, 0)), np.zeros(1))
        one_way = run(machine("slider"), (effect, np.array([[asymmetry]])), tape=tape, initial=begin)[0]
        expected = run(machine("slider"), (native, np.array([[damping]])), tape=tape, initial=begin)[0]
        assert np.array_equal(one_way, expected)


@pytest.mark.parametrize("host", ["fore", "brick"])
def test_a_payload_is_a_point_mass_welded_on(host):
    # in flight and in a vacuum: contacts and drag know bodies, not only their inertia
    xml = ARM if host == "fore" else BALL.replace("0 2 .12", "0 2 2").replace('density="1.2"', "")
    model = build(xml)
    effect = effects.REGISTRY.get("payload")(model, host)
    mass, place = 0.3, effect.centre.copy()
    place[effect.axes] += [0.03, -0.02, 0.04][: len(effect.axes)]
    spec = mujoco.MjSpec.from_string(xml)
    point = spec.body(host).add_body(name="point", pos=place)
    point.mass, point.ipos, point.inertia, point.explicitinertial = mass, [0.0] * 3, [1e-12] * 3, True
    welded = spec.compile()
    sensors, _ = run(model, (effect, np.append(mass, place[effect.axes])[None]))
    expected = run(welded, initial=start(model, 1), tape=controls(model, 1))[0]
    assert np.abs(run(model)[0] - expected).max() > 1e-3
    assert np.abs(sensors - expected).max() < 1e-6


@pytest.mark.parametrize(("host", "axes"), [("fore", "xz"), ("brick", "xyz")])
def test_where_a_payload_sits_is_looked_for_along_axes_on_which_it_shows(host, axes):
    effect = effects.REGISTRY.get("payload")(machine("arm" if host == "fore" else "ball"), host)
    assert effect.space.names == ("mass", *axes)
    assert len(effect.shape_grid()) == 1 + 2 * len(axes)


def test_of_bodies_that_are_fixed_to_each_other_a_payload_is_looked_for_at_the_first():
    model = build("""
        <mujoco><worldbody><body name="link"><joint axis="0 1 0"/><geom size=".1" mass="2"/>
          <body name="hand" pos="0 0 .5"><geom size=".05" mass=".3"/></body>
        </body></worldbody></mujoco>""")
    payload = effects.REGISTRY.get("payload")
    link, hand = (payload(model, name) for name in ("link", "hand"))
    for effect in (link, hand):
        effect.look_in(SeenLog(window=1.0, longest=1.0, logged=frozenset({0}), seen={}))
    assert link.shows and not hand.shows
    assert link.space.high[0] == pytest.approx(2 * 2.3)
    assert link.space.high[1] >= 1.5, "as far as for what its hand carries"


def test_a_light_flange_may_carry_a_heavy_tool():
    model = build("""
        <mujoco><worldbody><body><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .5" size=".04" mass="4"/>
          <body name="flange" pos="0 0 .5"><joint axis="1 0 0"/><geom size=".02" mass=".1"/></body>
        </body></worldbody></mujoco>""")
    space = effects.REGISTRY.get("payload")(model, "flange").space
    assert space.high[0] == pytest.approx(2 * 4.1)
    assert space.low[1:].max() <= -0.25 and space.high[1:].min() >= 0.25


def test_several_payloads_are_one_where_their_centre_is():
    effect = effects.REGISTRY.get("payload")(machine("arm"), "fore")
    shapes = effect.shape_grid()
    amplitudes = np.array([0.15, 0.1, 0.0, -0.05, 0.0])
    (mass, *place), span = effect.mixture(shapes, amplitudes), effect.space.span[0]
    assert mass == pytest.approx(0.2 * span)
    np.testing.assert_allclose(mass * np.array(place), span * amplitudes @ shapes[:, 1:])


def test_of_a_moment_without_mass_a_payload_has_as_much_as_that_takes():
    effect = effects.REGISTRY.get("payload")(machine("arm"), "fore")
    values = effect.mixture(effect.shape_grid(), np.array([0.0, 0.1, 0.0, -0.1, 0.0]))
    assert effect.space.low[1] <= values[1] <= effect.space.high[1]
    assert values[0] > 0
    assert not effect.mixture(effect.shape_grid(), np.zeros(5))[0]


def test_preloaded_springs_side_by_side_are_one():
    effect = effects.REGISTRY.get("preloaded-spring")(machine("arm"), "elbow")
    shapes, amplitudes = effect.shape_grid(6), np.array([0.3, -0.05, 0.1, 0.2, -0.1, 0.15])
    stiffness, rest = effect.mixture(shapes, amplitudes)
    position, each = np.linspace(-2, 2, 5), amplitudes * effect.space.span[0]
    together = -(each * (position[:, None] - shapes[:, 1])).sum(axis=1)
    np.testing.assert_allclose(-stiffness * (position - rest), together, rtol=1e-9, atol=1e-12)
    assert effect.mixture(shapes, np.array([1.0, 0, 0, 0, 0, -1.0])) is None  # rests nowhere
    assert effect.mixture(shapes, np.array([1.0, 0, 0, 0, 0, -0.9])) is None  # rests too far


def test_a_shifted_centre_of_mass_is_the_one_compiled_there():
    effect = effects.REGISTRY.get("com-shift")(machine("arm"), "fore")
    assert [p.name for p in effect.parameters] == ["x", "z"]  # along y, its only axis, nothing would move
    model = build(ARM)
    model.body("fore").ipos += [0.03, 0, -0.02]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    sensors, _ = run(machine("arm"), (effect, np.array([[0.03, -0.02]])))
    assert np.allclose(sensors, run(model)[0], atol=1e-12)


def test_gravity_leans_where_it_says():
    effect = effects.REGISTRY.get("gravity-tilt")(machine("puck"))
    fields = ModelFields(machine("puck"), 1)
    effect.write(fields, np.array([[0.1, 0.0]]))
    assert np.allclose(fields["opt.gravity"], [[9.81 * np.sin(0.1), 0, -9.81 * np.cos(0.1)]])


def test_a_sensor_may_drift_as_far_in_a_short_log_as_in_a_long_one():
    where, known = placed("sensor-drift")[0]
    drifting = type(known)(machine(where), known.site)
    [anywhere] = drifting.parameters
    drifting.longest = 2.0
    assert drifting.parameters[0].high == pytest.approx(10 * anywhere.high)


def test_ranges_end_where_physics_does_and_hold_what_is_twice_as_large():
    """At the low end no control arrives, nothing weighs, friction is gone; a sensor's reading still grows."""
    shares = ("control-gain", "control-reverse-gain", "control-fade", "friction-fade", "gravity-magnitude")
    for name in shares:
        change = placed(name)[0][1].parameters[0]
        assert change.low == -1 and change.high >= 1, name
    assert np.allclose(drive("control-gain", [1.0, -2.0], -1.0), 0)
    scale = placed("sensor-scale")[0][1].parameters[0]
    assert 0.2 < 1 + scale.low < 0.5 and scale.high >= 1
    tilt = effects.REGISTRY.get("gravity-tilt")(machine("puck"))
    fields = ModelFields(machine("puck"), 1)
    tilt.write(fields, np.array([[tilt.space.high[0], 0.0]]))
    assert np.allclose(fields["opt.gravity"], [[9.81, 0, 0]]), "level"


def test_lowering_the_friction_of_a_geom_lowers_that_of_its_equals():
    effect = effects.REGISTRY.get("contact-friction")(machine("ball"), "floor")
    fields = ModelFields(machine("ball"), 2)
    effect.write(fields, np.array([[-0.4], [0.4]]))
    ball, floor = (machine("ball").geom(n).id for n in ("ball", "floor"))
    assert np.allclose(fields["geom_friction"][:, [floor, ball], 0].max(axis=1), [0.6, 1.4])


BIPED = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1" friction=".5"/>
    <body name="hip" pos="0 0 .3"><freejoint/><geom name="trunk" size=".1" friction=".3"/>
      <body pos="0 .1 -.2"><joint name="left"/><geom name="l" size=".03" friction=".8"/></body>
      <body pos="0 -.1 -.2"><joint name="right"/><geom name="r" size=".03" friction=".8"/></body>
      <body pos="0 0 -.2"><joint name="tail"/><geom name="t" size=".03" friction=".7"/></body>
    </body>
  </worldbody>
  {contact}
</mujoco>
"""


def test_the_contacts_of_feet_of_one_make_change_together():
    model = mujoco.MjModel.from_xml_string(BIPED.format(contact=""))
    contact_friction = effects.REGISTRY.get("contact-friction")
    assert contact_friction.sites(model) == ["l+r", "floor", "l", "r", "t"]
    left, right, tail, floor = (model.geom(n).id for n in ("l", "r", "t", "floor"))
    fields = ModelFields(model, 2)
    contact_friction(model, "l+r").write(fields, np.array([[-0.4], [0.4]]))
    np.testing.assert_allclose(
        fields["geom_friction"][:, [left, right, tail, floor], 0],
        [[0.4, 0.4, 0.4, 0.4], [1.2, 1.2, 0.7, 0.5]],
    )
    contact_restitution = effects.REGISTRY.get("contact-restitution")
    assert contact_restitution.sites(model)[0] == "l+r"
    contact_restitution(model, "l+r").write(fields, np.array([[0.5], [0.0]]))
    np.testing.assert_allclose(fields["geom_solref"][:, [left, right, tail], 1], [[1.5, 1.5, 1], [1, 1, 1]])


def test_a_pair_that_is_given_is_not_taken_for_geoms_of_one_make():
    model = mujoco.MjModel.from_xml_string(
        BIPED.format(contact='<contact><pair geom1="l" geom2="r"/></contact>')
    )
    effect = effects.REGISTRY.get("contact-friction")(model, "l+r")
    assert effect.pair == 0
    assert effect.sites(model).count("l+r") == 1


# a rotor that drives a link, 1 kg together, through {joint}, both with damping and friction, and the same as one
TWO_MASSES = """
<mujoco><option timestep="1e-4" gravity="0 0 0" integrator="implicitfast"/>
  <default><geom type="sphere" size=".1" contype="0" conaffinity="0"/></default>
  <worldbody>
    <body><joint name="r" type="slide" axis="1 0 0" damping="{motor}" frictionloss="{dry}" solreffriction="5e-4 1"
      solimpfriction=".999 .999"/><geom mass="{rotor}"/></body>
    <body><joint name="l" type="slide" axis="1 0 0" damping="{link}" frictionloss="{rubs}" stiffness="30"/>
      <geom mass="{rest}"/></body>
  </worldbody>
  <tendon><fixed name="t" {joint}><joint joint="r" coef="1"/><joint joint="l" coef="-1"/></fixed></tendon>
  <actuator><motor joint="r"/></actuator><sensor><jointpos joint="l"/></sensor>
</mujoco>
"""
ONE_MASS = """
<mujoco><option timestep="1e-3" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
    <body><joint name="l" type="slide" axis="1 0 0" damping="4" frictionloss="{dry}" stiffness="30"/>
      <geom type="sphere" size=".1" mass="1" contype="0" conaffinity="0"/></body>
  </worldbody>
  <actuator><motor joint="l"/></actuator><sensor><jointpos joint="l"/></sensor>
</mujoco>
"""


NOTHING = np.zeros((1, 0)), np.zeros(1)  # activations and time, s, of a start
BOUNCY = (
    "backlash",
    'stiffness="4000" springlength="-.02 .02"',
    {"width": 0.04, "give": 1 / 4000, "damping_time": 1e-5},
)
SPRING = (
    "compliance",
    'stiffness="200" damping="0.6" springlength="0"',
    {"compliance": 1 / 200, "damping_time": 3e-3},
)
PLAY = (
    "backlash",
    'limited="true" range="-.02 .02" solreflimit="4e-4 3" solimplimit=".99 .999 .0001"',
    {"width": 0.04},
)


@pytest.mark.parametrize(("name", "joint", "values", "begin"), [(*SPRING, 3 / 200), (*PLAY, 0.02)])
@pytest.mark.parametrize(
    ("rotor", "motor_damping", "dry", "motor_friction"),
    [
        (0.3, 0.0, 0, 0),
        (0.3, 0.9, 0, 0),
        (0.8, 0.9, 0, 0),
        (0.3, 0.5, 1, 1),
        (0.6, 0.5, 1, 0.6),
        (0.3, 0.5, 1, 0),
    ],
)
def test_compliance_and_backlash_are_a_rotor_and_a_link(
    name, joint, values, begin, rotor, motor_damping, dry, motor_friction
):
    sides = {"rotor": rotor, "rest": 1 - rotor, "motor": 4 * motor_damping, "link": 4 * (1 - motor_damping)}
    rubs = {"dry": dry * motor_friction, "rubs": dry * (1 - motor_friction)}
    one, two = build(ONE_MASS.format(dry=dry)), build(TWO_MASSES.format(joint=joint, **sides, **rubs))
    tape = 3 * np.sign(np.cos(2 * np.pi * 1.3 * np.arange(900) * 1e-3))[None, :, None]
    # the rotor begins where the force holds it
    begin *= 1 - rotor if name == "compliance" else 1  # the link takes the rest of the force
    held = InitialStates(np.array([[begin, 0]]), np.full((1, 2), 0.1), np.zeros((1, 0)), np.zeros(1))
    truth = run(two, tape=np.repeat(tape, 10, axis=1), initial=held)[0][:, ::10]
    start = InitialStates(np.zeros((1, 1)), np.full((1, 1), 0.1), np.zeros((1, 0)), np.zeros(1))
    rigid = run(one, tape=tape, initial=start)[0]
    effect = effects.REGISTRY.get(name)(one, "l")
    values = {**values, "rotor": rotor, "motor_damping": motor_damping}
    at = effect.space.to_vector(values | ({"motor_friction": motor_friction} if dry else {}))
    sensors = run(one, (effect, at[None]), tape=tape, initial=start)[0]
    error, error_rigid = (np.sqrt(np.mean((s - truth) ** 2)) for s in (sensors, rigid))
    assert error < 0.1 * error_rigid


@pytest.mark.parametrize(("name", "joint", "values"), [SPRING, PLAY, BOUNCY])
@pytest.mark.parametrize("rotor", [0.3, 0.8])
@pytest.mark.parametrize("seen", ["l", "l+q", "l+v", "l+q+v"])  # which sensors are the rotor's
def test_an_encoder_on_the_motor_shows_the_rotor(name, joint, values, rotor, seen):
    shows = {"q": "r" if "+q" in seen else "l", "v": "r" if "+v" in seen else "l"}
    sensor = '<sensor><jointpos joint="l"/></sensor>'
    two = TWO_MASSES.format(joint=joint, rotor=rotor, rest=1 - rotor, motor=2, link=2, dry=0, rubs=0)
    both = '<sensor><jointpos name="q" joint="{q}"/><jointvel name="v" joint="{v}"/></sensor>'
    two = build(two.replace(sensor, both.format(**shows)))
    one = build(ONE_MASS.format(dry=0).replace(sensor, both.format(q="l", v="l")))
    tape = 3 * np.sign(np.cos(2 * np.pi * 1.3 * np.arange(900) * 1e-3))[None, :, None]
    gives = values.get("give", 0.0) + values.get("compliance", 0.0)
    ahead = values.get("width", 0.0) / 2 + gives * 3 * (1 - rotor)  # where the force holds the rotor
    link = -ahead if shows["q"] == "r" else 0.0
    held = InitialStates(
        np.array([[link + ahead, link]]), np.full((1, 2), 0.1), np.zeros((1, 0)), np.zeros(1)
    )
    truth = run(two, tape=np.repeat(tape, 10, axis=1), initial=held)[0][:, ::10]
    start = InitialStates(np.zeros((1, 1)), np.full((1, 1), 0.1), np.zeros((1, 0)), np.zeros(1))
    rigid = run(one, tape=tape, initial=start)[0]
    effect = effects.REGISTRY.get(name)(one, seen)
    assert effect.reported == {c for c, n in enumerate("qv") if shows[n] == "r"}
    at = effect.space.to_vector({**values, "rotor": rotor, "motor_damping": 0.5})
    sensors = run(one, (effect, at[None]), tape=tape, initial=start)[0]
    size = truth.std(axis=(0, 1))
    error, error_rigid = (np.sqrt(np.mean(((s - truth) / size) ** 2, axis=(0, 1))) for s in (sensors, rigid))
    assert (error < 0.2 * error_rigid).all()


@pytest.mark.parametrize(("name", "joint", "values"), [SPRING, PLAY])
@pytest.mark.parametrize("limit", ["", 'forcerange="-5 5"'])
@pytest.mark.parametrize("kinds", [["q"], ["q", "v"]])
def test_a_servo_closes_its_loop_on_what_the_motors_encoder_sees(name, joint, values, limit, kinds):
    rotor, kp, kv, target = 0.3, 150, 3, 0.05
    servo = f'<position joint="r" kp="{kp}" kv="{kv}" {limit}/>'
    sensors = "".join(f'<joint{ {"q": "pos", "v": "vel"}[kind] } name="{kind}" joint="r"/>' for kind in kinds)
    two = TWO_MASSES.format(joint=joint, rotor=rotor, rest=1 - rotor, motor=2, link=2, dry=0, rubs=0)
    two = two.replace('<motor joint="r"/>', servo).replace('<jointpos joint="l"/>', sensors)
    one = (
        ONE_MASS.format(dry=0).replace('<motor joint="l"/>', servo).replace('<jointpos joint="l"/>', sensors)
    )
    one, two = build(one.replace('"r"', '"l"')), build(two)
    tape = target * np.sign(np.cos(2 * np.pi * 1.3 * np.arange(900) * 1e-3))[None, :, None]
    held = min(kp * target, 5 if limit else np.inf) - kv * 0.1
    ahead = values.get("width", 0.0) / 2 + values.get("compliance", 0.0) * held * (1 - rotor)
    begin = InitialStates(np.array([[0.0, -ahead]]), np.full((1, 2), 0.1), *NOTHING)
    truth = run(two, tape=np.repeat(tape, 10, axis=1), initial=begin)[0][:, ::10]
    start = InitialStates(np.zeros((1, 1)), np.full((1, 1), 0.1), *NOTHING)
    effect = effects.REGISTRY.get(name)(one, "+".join(["l", *kinds]))
    at = effect.space.to_vector({**values, "rotor": rotor, "motor_damping": 0.5})
    shown, rigid = (run(one, *given, tape=tape, initial=start)[0] for given in ([(effect, at[None])], []))
    error, error_rigid = (((s - truth) ** 2).mean(axis=(0, 1)) ** 0.5 for s in (shown, rigid))
    assert (error < (0.5 if limit else 0.25) * error_rigid).all()  # at its limit a servo's gains count as 0


@pytest.mark.parametrize(("name", "joint", "values"), [SPRING, PLAY])
def test_an_actuators_encoder_shows_the_rotor_through_its_gear(name, joint, values):
    xml = (
        ONE_MASS.format(dry=0)
        .replace("<motor ", '<motor name="m" gear="-50" ')
        .replace(
            '<sensor><jointpos joint="l"/></sensor>',
            '<sensor><jointpos name="q" joint="l"/><jointvel name="v" joint="l"/>'
            '<actuatorpos name="turns" actuator="m"/><actuatorvel name="speed" actuator="m"/></sensor>',
        )
    )
    one = build(xml)
    tape = 0.06 * np.sign(np.cos(2 * np.pi * 1.3 * np.arange(900) * 1e-3))[None, :, None]
    start = InitialStates(np.zeros((1, 1)), np.full((1, 1), 0.1), *NOTHING)
    shown = {}
    for seen in ("l+q", "l+turns", "l+v", "l+speed"):
        effect = effects.REGISTRY.get(name)(one, seen)
        at = effect.space.to_vector({**values, "rotor": 0.6, "motor_damping": 0.5})
        shown[seen] = run(one, (effect, at[None]), tape=tape, initial=start)[0][0]
    assert np.abs(shown["l+q"][:, 0] - shown["l+v"][:, 0]).max() > 1e-3, (
        "the encoder on the motor shows nothing"
    )
    np.testing.assert_allclose(shown["l+turns"][:, 2], -50 * shown["l+q"][:, 0], atol=1e-12)
    np.testing.assert_allclose(shown["l+speed"][:, 3], -50 * shown["l+v"][:, 1], atol=1e-12)


@pytest.mark.parametrize(("name", "joint", "values"), [SPRING, PLAY])
@pytest.mark.parametrize(
    ("seen", "logged", "read"),  # read: of which of the two the speed is that the start was read to have
    [("l+q", "qv", "l"), ("l+v", "qv", "r"), ("l+q+v", "qv", "r"), ("l+q", "q", "r")],
)
def test_an_encoder_on_the_motor_shows_a_rotor_that_began_to_turn_alone(
    name, joint, values, seen, logged, read
):
    """In free flight, in which only the transmission moves them against each other; the play is not crossed."""
    sensor = '<sensor><jointpos joint="l"/></sensor>'
    both = '<sensor><jointpos name="q" joint="{q}"/><jointvel name="v" joint="{v}"/></sensor>'
    one, two = (
        xml.replace('damping="4"', "").replace('stiffness="30"', "") for xml in (ONE_MASS, TWO_MASSES)
    )
    shows = {kind: "r" if f"+{kind}" in seen else "l" for kind in "qv"}
    one = build(one.format(dry=0).replace(sensor, both.format(q="l", v="l")))
    sides = {"rotor": 0.3, "rest": 0.7, "motor": 0, "link": 0, "dry": 0, "rubs": 0}
    two = build(two.format(joint=joint, **sides).replace(sensor, both.format(**shows)))
    effect, states = effects.REGISTRY.get(name)(one, seen), np.array([[0.2, 0.1]])
    effect.logged = frozenset("qv".index(kind) for kind in logged)
    at = effect.space.to_vector({**values, "rotor": 0.3, "motor_damping": 0.0})[None]
    ahead, turning = (size[0] * state for size, state in zip(effect.looseness(at), states[0], strict=True))
    where, fast = ahead * (shows["q"] == "l"), 0.2 + turning * (read == "l")  # of the rotor
    held = InitialStates(np.array([[where, where - ahead]]), np.array([[fast, fast - turning]]), *NOTHING)
    tape = np.zeros((1, 60, 1))
    truth = run(two, tape=tape.repeat(10, axis=1), initial=held)[0][:, ::10]
    start = InitialStates(np.zeros((1, 1)), np.full((1, 1), 0.2), *NOTHING)
    force = effect.force(at, 1e-3, states=states)
    sensors = Engine(one).rollout(initial=start, controls=tape, forces=[force]).sensors
    error = np.abs(sensors - truth).max(axis=1)[0]
    assert (error < 0.02 * np.array([0.06 * turning, turning])).all()


WITH_A_LOAD = """
<mujoco><option timestep="0.001" gravity="0 0 0"/>
  <worldbody><body><joint name="l" type="slide" axis="1 0 0" damping="4"/>
    <geom type="sphere" size=".1" mass="{rest}" contype="0" conaffinity="0"/>{load}</body></worldbody>
  <actuator><motor joint="l"/></actuator><sensor><jointpos joint="l"/></sensor>
</mujoco>
"""


LOAD = """
    <body><joint type="slide" axis="1 0 0" stiffness="{stiffness}" damping="{damping}"/>
      <geom type="sphere" size=".1" mass="{loose}" contype="0" conaffinity="0"/></body>
"""


@pytest.mark.parametrize("loose", [0.15, 0.6])
@pytest.mark.parametrize(("frequency", "damping_ratio"), [(1.3, 0.03), (6.0, 0.3)])
@pytest.mark.parametrize("begin", [0.0, 0.02])
def test_a_loose_mass_is_a_body_on_a_spring(loose, frequency, damping_ratio, begin):
    turning = 2 * np.pi * frequency
    load = LOAD.format(loose=loose, stiffness=loose * turning**2, damping=2 * damping_ratio * loose * turning)
    two = build(WITH_A_LOAD.format(rest=1 - loose, load=load))
    one = build(WITH_A_LOAD.format(rest=1, load=""))
    tape = 3 * np.sign(np.cos(2 * np.pi * 1.1 * np.arange(1500) * 1e-3))[None, :, None]
    states = np.array([[0, begin]]), np.array([[0.1, 0.0]]), np.zeros((1, 0)), np.zeros(1)
    truth = run(two, tape=tape, initial=InitialStates(*states))[0]
    start = InitialStates(np.zeros((1, 1)), np.full((1, 1), 0.1), *states[2:])
    rigid = run(one, tape=tape, initial=start)[0]
    effect = effects.REGISTRY.get("loose-mass")(one, "l")
    at = effect.space.to_vector({"mass": loose, "frequency": frequency, "damping_ratio": damping_ratio})
    at_begin = effect.force(at[None], 1e-3, states=np.array([[1.0, 0.0]])).coefficients["displaced"][0]
    hidden = np.array([[begin / at_begin, 0.0]])
    force = effect.force(at[None], 1e-3, states=hidden)
    sensors = Engine(one).rollout(initial=start, controls=tape, forces=[force]).sensors
    error, error_rigid = (np.sqrt(np.mean((s - truth) ** 2)) for s in (sensors, rigid))
    assert error < 0.01 * error_rigid


@pytest.mark.parametrize("late", [0, 4], ids=["in time", "late"])
@pytest.mark.parametrize(("frequency", "damping_ratio"), [(1.3, 0.003), (6.0, 0.3), (18.0, 0.01)])
def test_a_loose_mass_begins_inside_a_log_as_the_log_shook_it(frequency, damping_ratio, late):
    turning, loose = 2 * np.pi * frequency, 0.3
    load = LOAD.format(loose=loose, stiffness=loose * turning**2, damping=2 * damping_ratio * loose * turning)
    two = build(WITH_A_LOAD.format(rest=1 - loose, load=load))
    one = build(WITH_A_LOAD.format(rest=1, load=""))
    tape = 3 * np.sign(np.cos(2 * np.pi * 1.1 * np.arange(6000) * 1e-3))[None, :, None]
    rollouts = Engine(two).rollout(
        InitialStates(np.zeros((1, two.nq)), np.zeros((1, two.nv)), np.zeros((1, 0)), np.zeros(1)),
        tape,
        keep=Keep(states=True),
    )
    truth, first = rollouts.sensors[0], np.array([600, 2150, 5500])
    effect = effects.REGISTRY.get("loose-mass")(one, "l")
    sampled = slice(None, None, 5)
    path, time = truth[sampled, 0], np.arange(6000)[sampled] * 1e-3
    path = np.concatenate([np.full(late, path[0]), path[: len(path) - late]])
    shown = np.full((3, 1), late * 5e-3)  # s
    whole, at_rest = (slice(0, len(path)),), np.zeros(1)
    seen = JointMotion(path.min(), path.max(), 1.0, path, whole, 0.0, time, begun=at_rest, begun_sd=at_rest)
    effect.look_in(SeenLog(0.5, 6.0, frozenset({0}), {0: seen}))
    at = effect.space.to_vector({"mass": loose, "frequency": frequency, "damping_ratio": damping_ratio})

    def error(in_log):
        force = effect.force(np.tile(at, (3, 1)), 1e-3, first=in_log, late=shown)
        moving = rollouts.qpos[0, first, :1], rollouts.qvel[0, first, :1]
        initial = InitialStates(*moving, np.zeros((3, 0)), np.zeros(3))
        own = np.stack([tape[0, a : a + 500] for a in first])
        sensors = Engine(one).rollout(initial, own, forces=[force]).sensors
        return np.sqrt(np.mean([(s - truth[a : a + 500]) ** 2 for s, a in zip(sensors, first, strict=True)]))

    assert error(first // 5) < 0.03 * error(None)


@pytest.mark.parametrize("begun", [0.0, 0.8])
def test_noise_does_not_make_a_path_swing_as_it_begins(begun):
    """Between two noisy samples a speed is known to 0.2 m/s; what is steadily moved does not swing."""
    time, noise = np.arange(500) * 4e-3, 5e-4
    path = begun * time + noise * np.random.default_rng(0).standard_normal(500)
    shaken = Shaken(
        time, path[:, None], np.ones(1), [slice(0, 500)], noise, np.array([[begun]]), np.array([5e-3])
    )
    first = np.array([100, 250, 400])
    swing = np.full(3, 1.4), np.full(3, 0.05)
    (place, speed), error, common = shaken.after(*swing, first, 2e-3)
    assert (common < 2e-3).all()
    place, speed = place[:, 0], speed[:, 0]
    assert (error < 2e-3).all()
    assert (np.abs(place - begun * time[first]) < 2 * error).all()
    assert (np.abs(speed - begun) < 2 * 2 * np.pi * 1.4 * error).all()


@pytest.mark.parametrize("window", [0.1, 0.5, 5.0])
def test_a_loose_mass_is_looked_for_where_it_swings_half_a_turn_in_a_window(window):
    effect = effects.REGISTRY.get("loose-mass")(build(WITH_A_LOAD.format(rest=1, load="")), "l")
    anywhere = effect.space
    effect.window = window
    frequency = effect.parameters[1]
    assert frequency.low == pytest.approx(np.clip(0.5 / window, anywhere.low[1], frequency.high / 4))
    assert frequency.low < frequency.nominal < frequency.high
    assert (effect.shape_grid()[:, 1] >= frequency.low).all()


ON_A_BASE = """
<mujoco><option timestep="0.001"/>
  <worldbody><body>{base}
    <body pos="0 0 1"><joint name="shoulder" type="hinge" axis="0 1 0" damping=".2"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="3" contype="0" conaffinity="0"/>
      <body pos="0 0 -.4"><joint name="elbow" type="hinge" axis="0 1 0" damping=".1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="2" contype="0" conaffinity="0"/>
        <site name="tip" pos="0 0 -.3" euler="0 90 0"/></body></body>
  </body></worldbody>
  <actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator>
  <sensor><jointpos joint="shoulder"/><jointpos joint="elbow"/><accelerometer name="imu" site="tip"/></sensor>
</mujoco>
"""


@pytest.mark.parametrize("mass", [5.0, 20.0])  # of the base, kg
@pytest.mark.parametrize(("frequency", "damping_ratio"), [(2.0, 0.02), (7.0, 0.2)])
@pytest.mark.parametrize("axis", ["x", "z"])
def test_a_base_that_gives_is_a_body_on_a_spring(mass, frequency, damping_ratio, axis):
    turning, total = 2 * np.pi * frequency, mass + 5.0
    base = f"""<joint type="slide" axis="{"1 0 0" if axis == "x" else "0 0 1"}" stiffness="{total * turning**2}"
        damping="{2 * damping_ratio * turning * total}" springref="{0.0 if axis == "x" else 9.81 / turning**2}"/>
        <geom type="box" size=".1 .1 .1" mass="{mass}" contype="0" conaffinity="0"/>"""
    on_springs, one = build(ON_A_BASE.format(base=base)), build(ON_A_BASE.format(base=""))
    time = np.arange(1500) * 1e-3
    tape = np.stack([6 * np.sign(np.cos(7 * time)), 1.5 * np.sign(np.sin(11 * time))], axis=1)[None]
    bent, still = np.array([[0.5, 0.4]]), np.zeros((1, 2))
    start = InitialStates(bent, still, np.zeros((1, 0)), np.zeros(1))
    both = InitialStates(np.pad(bent, ((0, 0), (1, 0))), np.zeros((1, 3)), np.zeros((1, 0)), np.zeros(1))
    truth, rigid = run(on_springs, tape=tape, initial=both)[0][0], run(one, tape=tape, initial=start)[0][0]
    effect = effects.REGISTRY.get("base-compliance")(one, axis)
    at = {"mobility": 5.0 / total, "frequency": frequency, "damping_ratio": damping_ratio}
    force = effect.force(effect.space.to_vector(at)[None], 1e-3)
    sensors = Engine(one).rollout(initial=start, controls=tape, forces=[force]).sensors[0]
    error, error_rigid = (np.sqrt(np.mean((s - truth) ** 2, axis=0)) for s in (sensors, rigid))
    # of both models, errors of the step itself are as large
    assert np.linalg.norm(error[:2]) < 0.04 * np.linalg.norm(error_rigid[:2])
    # an accelerometer jumps with a torque, the base a step later
    assert np.linalg.norm(error[2:]) < 0.1 * np.linalg.norm(error_rigid[2:])


@pytest.mark.parametrize(("name", "axes"), [("slider", ["x"]), ("arm", ["x", "z"])])
def test_a_base_gives_where_an_actuator_can_push_it(name, axes):
    assert effects.REGISTRY.get("base-compliance").sites(machine(name)) == axes


def test_a_base_gives_where_an_actuator_pulls_by_a_tendon():
    cable = '<tendon><fixed name="cable"><joint joint="l" coef="1"/></fixed></tendon><actuator>'
    pulled = ONE_MASS.format(dry=0).replace("<actuator>", cable)
    pulled = build(pulled.replace('<motor joint="l"/>', '<motor tendon="cable"/>'))
    assert effects.REGISTRY.get("base-compliance").sites(pulled) == ["x"]
    assert effects.REGISTRY.get("load-dependent-friction").sites(pulled) == ["l"]
    assert effects.REGISTRY.get("backlash").sites(pulled) == [], "whose motor is not the joint's alone"


def test_a_cable_over_a_pulley_pulls_at_the_joint_before():
    """Against a fixed tendon, which is that: its length is q + ratio p."""
    ratio = 0.7
    own, tendon = '<motor joint="elbow"/>', '<motor tendon="cable"/>'
    cable = f"""<tendon><fixed name="cable"><joint joint="elbow" coef="1"/><joint joint="shoulder" coef="{ratio}"/>
        </fixed></tendon><actuator>"""
    arm = ON_A_BASE.format(base="")
    plain_arm, cabled = build(arm), build(arm.replace("<actuator>", cable).replace(own, tendon))
    time = np.arange(1000) * 1e-3
    tape = np.stack([9 * np.cos(7 * time), 4 * np.sin(11 * time)], axis=1)[None]
    begin = InitialStates(np.array([[0.5, 0.4]]), np.zeros((1, 2)), np.zeros((1, 0)), np.zeros(1))
    truth, plain_one = run(cabled, tape=tape, initial=begin)[0], run(plain_arm, tape=tape, initial=begin)[0]
    effect = effects.REGISTRY.get("coupled-drive")(plain_arm, "elbow")
    assert effect.sites(plain_arm) == ["elbow"]
    force = effect.force(np.array([[ratio]]), 1e-3)
    sensors = Engine(plain_arm).rollout(initial=begin, controls=tape, forces=[force]).sensors[0]
    error, before = (np.sqrt(np.mean((s - truth) ** 2)) for s in (sensors, plain_one))
    assert error < 0.02 * before


@pytest.mark.parametrize("torque", [(5, 50), (50, 5)])
def test_a_cable_over_equal_pulleys_is_in_range_however_strong_the_motors_are(torque):
    own = ('<motor joint="shoulder"/>', '<motor joint="elbow"/>')
    xml = ON_A_BASE.format(base="").replace('mass="3"', 'mass="1"').replace('mass="2"', 'mass="1"')
    for motor, most in zip(own, torque, strict=True):
        limited = motor.replace("/>", f' ctrllimited="true" ctrlrange="-{most} {most}"/>')
        xml = xml.replace(motor, limited)
    (ratio,) = effects.REGISTRY.get("coupled-drive")(build(xml), "elbow").parameters
    assert ratio.low <= -1 and ratio.high >= 1


def drive(name: str, tape: np.ndarray, *values: float) -> np.ndarray:
    """What reaches the slider's actuator of `tape` (grid,), in steps of 1 s."""
    effect = effects.REGISTRY.get(name)(machine("slider"), "drive")
    return effect.drive(np.asarray(tape, dtype=float)[None, :, None], np.array([values]), 1.0)[0, :, 0]


def test_controls_arrive_as_the_effects_say():
    tape = [1.0, 1.0, 3.0, 3.0, -2.0, -2.0]
    assert np.allclose(drive("control-delay", tape, 1.0), [1, 1, 1, 3, 3, -2])
    assert np.allclose(drive("control-delay", tape, 1.25), [1, 1, 1, 2.5, 3, -0.75])
    assert np.allclose(drive("control-gain", tape, 0.5), np.multiply(tape, 1.5))
    assert np.allclose(drive("control-reverse-gain", tape, 0.5), [1, 1, 3, 3, -3, -3])
    assert np.allclose(drive("control-bias", tape, 0.5), np.add(tape, 0.5))
    assert np.allclose(drive("control-dead-zone", tape, 1.5), [0, 0, 1.5, 1.5, -0.5, -0.5])
    assert np.allclose(drive("control-saturation", tape, 1.5), [1, 1, 1.5, 1.5, -1.5, -1.5])
    bent = np.array([1, 1, 3, 3, -2, -2]) / np.sqrt([1.02, 1.02, 1.18, 1.18, 1.08, 1.08])
    assert np.allclose(drive("control-nonlinearity", tape, 0.02), bent)
    # one unit in 0.4 s: 2 units take 0.8 of the step, 5 units two steps
    assert np.allclose(drive("control-rate-limit", tape, 0.4), [1, 1, 2.2, 3, 1.75, -0.75])
    lag = drive("control-lag", [0.0, 1.0, 1.0, 1.0], 2.0)
    start_of_step = 1 - np.exp(-np.arange(4) / 2)
    mean = 1 - 2 * (np.exp(-np.arange(3) / 2) - np.exp(-np.arange(1, 4) / 2))
    assert np.allclose(lag[1:], mean) and (lag[1:] > start_of_step[:-1]).all()


@pytest.mark.parametrize("damping_ratio", [0.3, 0.999, 1.0, 1.001, 1.5])
def test_a_second_order_lag_is_its_differential_equation(damping_ratio):
    tape = np.array([0.0, 1.0, 1.0, 3.0, 3.0, -2.0])
    time_constant = 1.3
    # of (x, x', integral of x, control), over a step of 1 s
    rates = np.zeros((4, 4))
    rates[0, 1] = rates[2, 0] = 1
    rates[1] = np.array([-1, -2 * damping_ratio * time_constant, 0, 1]) / time_constant**2
    over_step, state, means = expm(rates), np.zeros(4), []
    for control in tape:
        state = over_step @ [state[0], state[1], 0.0, control]
        means.append(state[2])
    arrived = drive("control-second-order-lag", tape, time_constant, damping_ratio)
    np.testing.assert_allclose(arrived, means, atol=1e-11)
    # for a slow control it is a delay
    ramp = np.arange(200.0)
    late = ramp - drive("control-second-order-lag", ramp, time_constant, damping_ratio)
    np.testing.assert_allclose(late[-1], 2 * damping_ratio * time_constant, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "value", "tolerance"),
    [
        ("control-delay", [0.0234], 1e-12),
        ("control-lag", [0.05], 1e-8),
        ("control-second-order-lag", [0.05, 0.8], 1e-5),
        ("control-rate-limit", [0.2], 1e-12),
    ],
)
def test_an_actuator_knows_in_a_window_what_came_before_it(name, value, tolerance):
    """Windows that begin in true states end up where the simulation of the whole episode does."""
    task = load_task(str(SLIDER))
    effect = effects.REGISTRY.get(name)(task.model, "drive")
    time = 0.004 * np.arange(750)
    log = {"time": time, "inputs": 30 * np.sign(np.sin(61 * time))[:, None], "outputs": np.zeros((750, 1))}
    samples = Log(**log, episodes=[slice(0, 750)])
    whole, windows = (cut(samples, d, task.timestep, [HELD]) for d in (None, 0.5))
    values = np.array([value])
    rollout = Engine(task.model, 1).rollout(
        initial=model_initial_states(task.model, 1).states,
        controls=effect.drive(task.controls(whole.controls), values, task.timestep),
        keep=Keep(states=True),
    )
    at = np.rint(windows.time / task.timestep).astype(int)
    initial = InitialStates(rollout.qpos[0, at], rollout.qvel[0, at], np.zeros((len(at), 0)), windows.time)
    point = np.concatenate([task.space.nominal, value])
    simulated = (
        Simulator(task, [(name, effect)], threads=1).simulate(windows, initial, point[None]).outputs[0]
    )
    expected = whole.sample(rollout.sensors, np.array([0]))[0].reshape(len(at), -1, 1)
    assert len(at) > 4
    np.testing.assert_allclose(simulated, expected, rtol=0, atol=tolerance)
    held = Simulator(task, [(name, effect)], threads=1).simulate(
        replace(windows, sequences=CachedSequences(windows.controls)), initial, point[None]
    )
    assert np.abs(held.outputs[0] - expected)[1:].max() > 1e-4


@pytest.mark.parametrize(("name", "site"), [("control-fade", "drive"), ("friction-fade", "x")])
def test_what_fades_began_to_with_the_episode(name, site):
    """In every window, wherever the log's clock begins, it is as far as in the simulation of the whole episode."""
    task = load_task(str(SLIDER))
    effect = effects.REGISTRY.get(name)(task.model, site)
    time = 5 + 0.004 * np.arange(750)
    log = {"time": time, "inputs": 30 * np.sign(np.sin(61 * time))[:, None], "outputs": np.zeros((750, 1))}
    samples = Log(**log, episodes=[slice(0, 750)])
    whole, windows = (cut(samples, d, task.timestep, [HELD]) for d in (None, 0.5))
    values, zero = np.array([[-0.6, 1.5]]), np.zeros(1)
    begin = replace(model_initial_states(task.model, 1).states, time=np.array([5.0]))
    force = effect.force(values, task.timestep, began=begin.time)
    rollout = Engine(task.model, 1).rollout(
        initial=begin,
        controls=effect.drive(task.controls(whole.controls), values, task.timestep, elapsed=zero),
        forces=[f for f in [force] if f],
        keep=Keep(states=True),
    )
    at = np.rint((windows.time - 5) / task.timestep).astype(int)
    initial = InitialStates(rollout.qpos[0, at], rollout.qvel[0, at], np.zeros((len(at), 0)), windows.time)
    point = np.concatenate([task.space.nominal, values[0]])
    simulated = (
        Simulator(task, [(name, effect)], threads=1).simulate(windows, initial, point[None]).outputs[0]
    )
    expected = whole.sample(rollout.sensors, np.array([0]))[0].reshape(len(at), -1, 1)
    np.testing.assert_allclose(simulated, expected, rtol=0, atol=1e-9)
    anew = replace(windows, elapsed=np.zeros(len(windows)))
    anew = Simulator(task, [(name, effect)], threads=1).simulate(anew, initial, point[None]).outputs[0]
    assert np.abs(anew - expected)[1:].max() > 1e-4


@pytest.mark.parametrize("recordings", [1, 2])
def test_a_motor_is_as_hot_in_a_window_as_its_log_made_it(recordings):
    """In every window of two episodes it has lost what a simulation from the beginning of its episode has it lose."""
    model, values = load_task(str(SLIDER)).model, np.array([5e-4, 0.1, 1.5])
    effect = effects.REGISTRY.get("control-heat-fade")(model, "drive")
    time = np.concatenate([5 + 0.004 * np.arange(750), 20 + 0.004 * np.arange(500)])
    control = 30 * np.sign(np.sin(61 * time)) * np.where(time % 2 < 1, 1.0, 0.3)
    log = {"time": time - 5, "episodes": [slice(0, 750), slice(750, 1250)]}
    samples = Log(**log, inputs=control[:, None], outputs=np.zeros((1250, 1)))
    windows = cut(samples, 0.5, 0.002, [HELD])
    before = [0.1, 0.1] if recordings == 1 else [0.1, 0.25]

    def lost(tape, values, **known):
        arrives = effect.drive(tape, np.repeat(values[None], len(tape), axis=0), 0.002, **known)
        return (1 - arrives / tape)[:, ::2, 0]

    expected = [
        lost(np.repeat(control[e], 2)[None, :, None], np.where(values == 0.1, b, values))[0]
        for e, b in zip(log["episodes"], before, strict=True)
    ]
    expected = np.concatenate(expected)[windows.first[:, None] + np.arange(100)]
    cold = lost(windows.controls, values, elapsed=windows.elapsed)
    driven = Driven(**log, controls={0: control})
    of = Recordings(np.repeat(np.arange(2) % recordings, [750, 500]), log["time"], 0)
    effect.look_in(
        SeenLog(window=0.5, longest=3.0, logged=frozenset(), seen={}, driven=driven, recordings=of)
    )
    values = np.array([5e-4, *before[:recordings], 1.5])
    warm = lost(windows.controls, values, elapsed=windows.elapsed, first=windows.first)[:, :100]
    assert len(windows) == 10 and expected.max() > 0.25
    np.testing.assert_allclose(warm, expected, atol=2e-3)
    assert (np.abs(cold[:, 0] - expected[:, 0]) > 0.01).sum() >= 8
    assert [effect.of_one_recording(n) for n in effect.space.names].count(True) == recordings - 1


@pytest.mark.parametrize("error", [-0.008, 0.03])
def test_a_clock_drifts_from_the_start_of_the_episode(error):
    """Windows that begin where the sensors say agree with the sensors of the whole episode."""
    task = load_task(str(SLIDER))
    effect = effects.REGISTRY.get("sensor-clock-rate")(task.model, GLOBAL)
    time = 0.004 * np.arange(750)
    log = {"time": time, "inputs": 30 * np.sin(11 * time)[:, None], "outputs": np.zeros((750, 1))}
    samples = Log(**log, episodes=[slice(0, 750)])
    whole, windows = (cut(samples, d, task.timestep, [EVENLY]) for d in (None, 0.5))
    rollout = Engine(task.model, 1).rollout(
        initial=model_initial_states(task.model, 1).states,
        controls=task.controls(whole.controls),
        keep=Keep(states=True),
    )
    told = effect.measure(rollout.sensors, np.array([[error]]), task.timestep)
    truly = windows.time[:-1] * (1 + error) / task.timestep  # the last one needs what comes after the episode
    grid = np.arange(rollout.qpos.shape[1])
    qpos, qvel = (np.interp(truly, grid, v[0, :, 0])[:, None] for v in (rollout.qpos, rollout.qvel))
    inside = windows.rows(slice(0, len(truly)))
    initial = InitialStates(qpos, qvel, np.zeros((len(truly), 0)), inside.time)
    point = np.array([*task.space.nominal, error])
    simulator = Simulator(task, [("sensor-clock-rate", effect)], threads=1)
    simulated = simulator.simulate(inside, initial, point[None]).outputs[0]
    expected = whole.sample(told, np.array([0]))[0, : simulated.size].reshape(simulated.shape)
    np.testing.assert_allclose(simulated, expected, rtol=0, atol=5e-5)
    unaware = replace(inside, elapsed=np.zeros(len(truly)))
    assert np.abs(simulator.simulate(unaware, initial, point[None]).outputs[0] - expected).max() > 5e-4


@pytest.mark.parametrize("name", [name for name in NAMES if effects.REGISTRY.get(name).place == "control"])
def test_how_long_controls_are_remembered_is_said_in_the_docs(name):
    said = effects.REGISTRY.get(name).remembers
    assert (f"| `{name}` | {said} |" in PAGE) == bool(said)
    for _, effect in placed(name):
        followed = said == "all since the episode began"  # the log says them, and no lead of a window
        assert (effect.memory(effect.space.high[None]) > 0) == (bool(said) and not followed)


@pytest.mark.parametrize(
    ("name", "values", "memory", "said"),
    [
        ("control-lag", (0.1,), 20 * 0.1, "20 `time_constant`"),
        ("control-lag", (0.4,), 4.0, "4 s at most"),
        ("control-second-order-lag", (0.1, 0.5), 12 * 0.1 / 0.5, "12 time constants"),
        ("control-second-order-lag", (0.1, 1.0), 12 * 0.1, "12 time constants"),
        ("control-second-order-lag", (0.15, 0.3), 4.0, "4 s at most"),
        ("control-supply-sag", (0.01, 0.3), 8 * 0.3, "8 `time_constant`"),
        ("control-delay", (0.07,), 0.07, "`delay`"),
    ],
)
def test_controls_are_remembered_for_as_long_as_the_docs_say(name, values, memory, said):
    _, effect = placed(name)[0]
    assert effect.memory(np.array([values])) == pytest.approx(memory)
    assert said in effect.remembers


def test_no_actuator_remembers_longer_than_windows_know():
    for name in NAMES:
        for _, effect in placed(name):
            assert effect.memory(effect.space.high[None]) <= WINDOWS.lead
            assert effect.memory(effect.space.nominal[None]) == 0


def measure(name: str, series: np.ndarray, *values: float) -> np.ndarray:
    """What the slider's sensor x reports of `series` (grid,), in steps of 1 s."""
    effect = effects.REGISTRY.get(name)(machine("slider"), "x" if name != "sensor-clock-rate" else GLOBAL)
    series = np.stack([series, series], axis=-1).astype(float)
    return effect.measure(series[None], np.array([values]), 1.0)[0, :, 0]


def test_sensors_report_as_the_effects_say():
    ramp = np.arange(6.0)
    assert np.allclose(measure("sensor-delay", ramp, 1.3), ramp - 1.3)  # before the start, too
    assert np.allclose(measure("sensor-delay", ramp**2, 2.0)[2:], ramp[:-2] ** 2)
    assert np.allclose(measure("sensor-clock-rate", ramp, 0.1), 1.1 * ramp)
    assert np.allclose(measure("sensor-own-clock", ramp, 0.1), 1.1 * ramp)
    assert np.allclose(measure("sensor-low-pass", ramp, 0.7), ramp - 0.7)
    step = measure("sensor-low-pass", np.array([0.0, 0, 1, 1, 1]), 2.0)
    rise = 1 - 2 * (1 - np.exp(-0.5))  # at the end of a ramp from 0 to 1
    assert np.allclose(step[2:], 1 - (1 - rise) * np.exp(-np.arange(3) / 2))
    assert np.allclose(measure("sensor-second-order-low-pass", ramp, 0.7, 0.6), ramp - 2 * 0.6 * 0.7)
    assert np.allclose(measure("sensor-quantisation", ramp, 2.5), [0, 0, 2.5, 2.5, 5, 5])
    assert np.allclose(measure("sensor-scale", ramp, 0.1), 1.1 * ramp)
    assert np.allclose(measure("sensor-bias", ramp, 0.1), ramp + 0.1)
    assert np.allclose(measure("sensor-drift", ramp, 0.1), 1.1 * ramp)


@pytest.mark.parametrize("damping_ratio", [0.3, 0.7, 1.0, 1.5])
def test_a_sensor_behind_a_filter_of_second_order_reports_what_that_lets_through(damping_ratio):
    from scipy.signal import lsim

    series = np.cumsum(np.random.default_rng(1).normal(size=40))
    series[:2] = 0.0  # at rest at first, as `lsim` begins
    filtered = ([1.0], [1.7**2, 2 * damping_ratio * 1.7, 1.0])
    expected = lsim(filtered, series, np.arange(40.0))[1]  # straight between rows, too
    np.testing.assert_allclose(
        measure("sensor-second-order-low-pass", series, 1.7, damping_ratio), expected, atol=1e-9
    )


def in_log(name: str, where: str, site: str, reported: np.ndarray) -> Effect:
    """The effect, looked for in a log in which each number of its sensor is `reported` (step,)."""
    effect = effects.REGISTRY.get(name)(machine(where), site)
    values = np.full((len(reported), machine(where).nsensordata), np.nan)
    values[:, effect.columns] = reported[:, None]
    reports = Reports(
        0.01 * np.arange(len(reported)), values, [slice(0, len(reported))], np.zeros(values.shape[1])
    )
    effect.look_in(SeenLog(window=1.0, longest=20.0, logged=effect.reported, seen={}, reports=reports))
    return effect


def test_what_a_filter_held_is_as_large_as_the_log_shows_its_sensor_to_move():
    """A state is 1 where the sensor went as far as its size in a second: more is common in a log where it is faster."""
    reported = np.cumsum(np.full(300, 0.5))  # 50 per s
    fast = in_log("sensor-second-order-low-pass", "cart_pole", "cart", reported)
    alone = effects.REGISTRY.get("sensor-second-order-low-pass")(machine("cart_pole"), "cart")
    values, still = np.array([[0.02, 0.7]]), np.zeros((1, 4, machine("cart_pole").nsensordata))
    held = [e.measure(still, values, 0.002, states=np.array([[1.0, 0.0]])) for e in (fast, alone)]
    np.testing.assert_array_equal(*held)  # what an estimate says of windows needs no log to be simulated
    size = alone.quantity.size
    assert held[0][0, 0, alone.columns] == pytest.approx(0.02 * size)
    first = np.array([0, 200])
    np.testing.assert_allclose(fast.states_sd(first), np.full((2, 2), 50 / size))
    np.testing.assert_array_equal(alone.states_sd(first), np.ones((2, 2)))


def test_a_gyroscope_beyond_its_range_reports_the_limit():
    effect = effects.REGISTRY.get("sensor-saturation")(machine("arm"), "gyro")
    sensors = np.random.default_rng(0).normal(size=(1, 9, machine("arm").nsensordata))
    seen = effect.measure(sensors, np.array([[0.7]]), 0.01)
    own = effect.columns
    np.testing.assert_array_equal(seen[..., own], np.clip(sensors[..., own], -0.7, 0.7))
    np.testing.assert_array_equal(np.delete(seen, own, axis=2), np.delete(sensors, own, axis=2))


def test_positions_that_end_are_no_saturation():
    """Where a window begins would be unknown."""
    assert effects.REGISTRY.get("sensor-saturation").sites(machine("arm")) == ["gyro"]
    assert effects.REGISTRY.get("sensor-saturation").sites(machine("slider")) == ["v"]


@pytest.mark.parametrize("limit", [0.6, 0.9])
@pytest.mark.parametrize("noise_is_cut_off", [True, False])
def test_a_limit_is_looked_for_where_numbers_pile_up_and_not_above(limit, noise_is_cut_off):
    time = 0.01 * np.arange(2000)
    moved = 3 * np.sin(2 * time) * np.sin(0.31 * time)
    noise = 0.02 * np.random.default_rng(1).normal(size=len(time))
    cut = 3 * limit * np.ones(len(time))
    seen = np.clip(moved + noise, -cut, cut) if noise_is_cut_off else np.clip(moved, -cut, cut) + noise
    effect = in_log("sensor-saturation", "slider", "v", seen)
    assert effect.shows
    assert effect.space.low[0] < 3 * limit < effect.space.high[0] < 1.1 * 3 * limit
    assert not in_log("sensor-saturation", "slider", "v", moved + noise).shows
    spiked = np.where(np.arange(len(time)) == 70, 40.0, seen)
    assert in_log("sensor-saturation", "slider", "v", spiked).space.high[0] < 1.1 * 3 * limit


def test_a_reading_may_bend_by_a_share_of_what_the_log_has():
    x = np.linspace(-2.0, 2.0, 9)
    speed = effects.REGISTRY.get("sensor-nonlinearity")(machine("slider"), "v")
    seen = speed.measure(np.stack([x, x], axis=-1)[None], np.array([[0.1, -0.01]]), 1.0)[0]
    np.testing.assert_allclose(seen.T, [x, x + 0.1 * x**2 - 0.01 * x**3])
    assert speed.sites(machine("slider")) == ["v"], "not of a length"
    effect = in_log("sensor-nonlinearity", "slider", "v", np.linspace(-3.0, 2.0, 50))
    quadratic, cubic = effect.parameters
    assert (quadratic.unit, cubic.unit) == ("1/(m/s)", "1/(m/s)^2")
    assert quadratic.high == pytest.approx(0.375 / 3) and cubic.high == pytest.approx(0.25 / 9)
    for values in ([-quadratic.high, 0.0], [0.0, -cubic.high]):
        ends = speed.measure(x[None, :, None] * 1.5 * np.ones(2), np.array([values]), 1.0)[0, :, 1]
        assert (np.diff(ends) > 0).all(), "it grows up to the largest number"


def test_a_bent_reading_is_straightened_as_far_as_it_grows():
    effect = effects.REGISTRY.get("sensor-nonlinearity")(machine("slider"), "v")
    values = np.array([[0.0, 0.0], [0.3, 0.0], [-0.3, 0.0], [0.2, 0.1], [0.1, -0.2], [-0.1, -0.2]])
    true = np.linspace(-0.7, 0.7, 15)
    for x in true:
        derivatives = np.zeros((len(values), 3, machine("slider").nsensordata))
        quadratic, cubic = values.T
        gain, bend = 1 + 2 * quadratic * x + 3 * cubic * x**2, 2 * quadratic + 6 * cubic * x
        derivatives[..., 1] = np.stack(
            [x + quadratic * x**2 + cubic * x**3, gain * 2.0, gain * 5.0 + bend * 4.0], 1
        )
        found = effect.true_motion(derivatives, values)[..., 1]
        np.testing.assert_allclose(found, np.tile([x, 2.0, 5.0], (len(values), 1)), atol=1e-9)
    far = np.full((len(values), 3, machine("slider").nsensordata), 1e3)
    assert np.isfinite(effect.true_motion(far, values)).all()
    assert np.abs(effect.true_motion(-far, values)[1, 0, 1]) < 1 / (2 * 0.3)  # where it turns back


def test_a_sensor_drifts_since_the_episode_began():
    where, effect = placed("sensor-drift")[0]
    rate, elapsed = np.full((2, len(effect.space)), 0.1), np.array([0.0, 5.0])
    sensors = np.zeros((2, 3, machine(where).nsensordata))
    seen = effect.measure(sensors, rate, 0.5, elapsed=elapsed)[..., effect.columns]
    np.testing.assert_allclose(seen[..., 0], [[0.0, 0.05, 0.1], [0.5, 0.55, 0.6]])
    derivatives = np.zeros((2, 3, machine(where).nsensordata))
    true = effect.true_motion(derivatives, rate, elapsed)[..., effect.columns.start]
    np.testing.assert_allclose(true, [[0, -0.1, 0], [-0.5, -0.1, 0]])


def test_an_encoder_off_its_axis_errs_once_and_twice_a_turn():
    where, effect = placed("sensor-eccentricity")[0]
    angle = 2 * np.pi * np.arange(64) / 64
    sensors = np.repeat(angle[None, :, None], machine(where).nsensordata, axis=2)
    seen = effect.measure(sensors, np.array([[0.01, -0.02, 0.03, 0.04]]), 1.0)
    errors = np.fft.rfft((seen - sensors)[0, :, effect.columns.start]) / 32
    expected = np.zeros(33, dtype=complex)
    expected[1], expected[2] = -0.02 - 0.01j, 0.04 - 0.03j  # cosine - i sine
    np.testing.assert_allclose(errors, expected, atol=1e-12)


TWO_MOTORS = """
<mujoco>
  <worldbody>
    <body><joint name="a" type="slide"/><geom size=".1"/></body>
    <body><joint name="b" type="slide"/><geom size=".1"/></body>
  </worldbody>
  <actuator>
    <motor joint="a" ctrllimited="true" ctrlrange="-2 2"/>
    <motor joint="b" ctrllimited="true" ctrlrange="-4 4"/>
    <position joint="b" kp="3"/>
  </actuator>
</mujoco>
"""


def test_a_supply_sags_with_what_all_its_actuators_draw():
    effect = effects.REGISTRY.get("control-supply-sag")(build(TWO_MOTORS))
    step, time_constant, sag = 1e-3, 0.1, 0.4
    controls = np.zeros((1, 1000, 3))
    controls[0, :, 2] = 0.7  # a target: nothing that a supply can lower
    controls[0, 100:, :2] = 1.0, -2.0
    arrive = effect.drive(controls, np.array([[sag, time_constant]]), step)[0]
    since = step * (np.arange(100, 1000) - 99.5)  # the middle of each step, from 100 on
    size = 1 - sag * 1.5 * (1 - np.exp(-since / time_constant))
    np.testing.assert_allclose(arrive[100:, 0], size, atol=1e-3 * sag)
    np.testing.assert_allclose(arrive[:, 1], -2 * arrive[:, 0])
    assert np.array_equal(arrive[:, 2], controls[0, :, 2])
    assert effect.parameters[0].high == pytest.approx(1 / 3.0)  # all at their largest: a mean of 3


@pytest.mark.parametrize("time_constant", [0.0, 0.05])
def test_servos_on_one_supply_are_weaker_the_more_all_of_them_give(time_constant):
    """Of joints too heavy to move: what each gives is 1 / (1 + sag load) of what it would, at once or after a while."""
    model = build(TWO_MOTORS)
    model.dof_armature[:] = 1e9
    mujoco.mj_setConst(model, mujoco.MjData(model))
    effect = effects.REGISTRY.get("force-supply-sag")(model)
    told, count, sag = np.array([1.0, -2.0, 0.7]), 400, 2.4
    tape = np.repeat(np.stack([0 * told, told]), count // 2, axis=0)[None]
    given = Engine(model, threads=1).rollout(
        initial=InitialStates(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 0)), np.zeros(1)),
        controls=tape,
        forces=[effect.force(np.array([[sag, time_constant]]), model.opt.timestep)],
        keep=Keep(actuator_forces=True),
    )
    would = told * [1.0, 1.0, 3.0]
    size = given.actuator_force[0, count // 2 :] / would
    since = model.opt.timestep * (np.arange(count // 2) - 0.5)  # the load is that of the step before
    felt = 1 - np.exp(-since / time_constant) if time_constant else np.ones(count // 2)
    np.testing.assert_allclose(size[2:, 0], (1 / (1 + sag * np.abs(would).mean() * felt))[2:], rtol=1e-3)
    np.testing.assert_allclose(size, np.repeat(size[:, :1], 3, axis=1), rtol=1e-4)


@pytest.mark.parametrize("name", [n for n in NAMES if type(placed(n)[0][1]).drive is ActuatorEffect.drive])
def test_what_arrives_of_all_steps_is_what_arrives_step_by_step(name):
    generator, effect = np.random.default_rng(0), placed(name)[0][1]
    coefficients = effect.coefficients(effect.space.from_unit(generator.random((3, len(effect.space)))))
    told = generator.standard_normal((80, 3))
    arrive = bound(effect.kernel, coefficients, 2e-3)
    found = effect.arrived(told, coefficients, 2e-3)
    np.testing.assert_array_equal(found, [arrive(now) for now in told])
    np.testing.assert_allclose(effect.at_once(told, coefficients, 2e-3), found, rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", ["control-lag", "control-second-order-lag", "control-delay"])
def test_what_does_nothing_to_controls_leaves_all_of_their_steps_as_they_were(name):
    effect = placed(name)[0][1]
    coefficients = effect.coefficients(np.repeat(effect.space.nominal[None], 3, axis=0))
    told = np.random.default_rng(0).standard_normal((80, 3))
    np.testing.assert_array_equal(effect.at_once(told, coefficients, 2e-3), told)


@pytest.mark.parametrize("name", ["control-rate-limit", "control-gain", "control-second-order-lag"])
def test_an_effect_on_a_control_is_the_same_among_fewer_of_them(name):
    effect = placed(name)[0][1]
    effect.columns = np.array([2])
    controls = np.random.default_rng(0).standard_normal((2, 50, 4))
    values = effect.space.from_unit(np.full((2, len(effect.space)), 0.3))
    columns = np.array([1, 2])
    found = effect.among(columns).drive(controls[..., columns], values, 2e-3)
    np.testing.assert_allclose(found, effect.drive(controls, values, 2e-3)[..., columns], atol=1e-13)


def test_a_supply_in_the_middle_of_its_lag_begins_with_the_load_that_it_feels():
    """With `more` of what it felt beyond the load of the moment it goes on as if it had been followed all along."""
    sag = effects.REGISTRY.get("force-supply-sag").kernel
    given, step = np.abs(np.sin(np.linspace(0, 20, 400))), 2e-3
    whole = sag(sag=0.8, time_constant=0.3, timestep=step)
    sizes, felt = [], []
    for load in given:
        felt.append(whole.felt.state)
        sizes.append(whole(load * whole.size))
    half = sag(sag=0.8, time_constant=0.3, timestep=step, more=felt[200] - given[200])
    again = [half(load * half.size) for load in given[200:]]
    np.testing.assert_allclose(again, sizes[200:], rtol=1e-12)
    forgotten = sag(sag=0.8, time_constant=0.3, timestep=step)
    assert abs(forgotten(given[200]) - sizes[200]) > 0.05


@pytest.mark.parametrize(
    ("speed", "low", "high"), [(0.0, -2, 2), (3.0, -2, 1), (-1.5, -1.5, 2), (9.0, -2, 0)]
)
@pytest.mark.parametrize("open_gear", [False, True])
def test_a_motor_gives_less_the_faster_it_turns_and_brakes_with_all_it_has(speed, low, high, open_gear):
    """Of a joint too heavy to be slowed: 2 N at rest, none at 3 m/s times the gear of 2."""
    model = build(TWO_MOTORS)
    model.dof_armature[:] = 1e9
    model.actuator_gear[0, 0] = 1.0 if open_gear else 2.0
    mujoco.mj_setConst(model, mujoco.MjData(model))
    effect = effects.REGISTRY.get("torque-speed-limit")(model, model.actuator(0).name or "#0")
    asked = np.array([-9.0, -1.2, 0.3, 9.0]).clip(-2, 2)
    model.actuator_ctrllimited[0] = False
    count = len(asked)
    fields = ModelFields(model, count)
    fields["actuator_gear"][:, 0, 0] = 2.0
    values = np.tile([2.0, 12.0], (count, 1))
    effect.write(fields, values)
    given = Engine(model, threads=1).rollout(
        initial=InitialStates(
            np.zeros((count, 2)), np.full((count, 2), speed), np.zeros((count, 0)), np.zeros(count)
        ),
        controls=np.repeat(np.stack([asked, 0 * asked, 0 * asked], axis=-1)[:, None], 2, axis=1),
        fields=fields,
        forces=[effect.force(values, model.opt.timestep)],
        keep=Keep(actuator_forces=True),
    )
    np.testing.assert_allclose(given.actuator_force[:, 0, 0], np.clip(asked, low, high))


def test_a_spring_over_two_joints_is_that_of_a_tendon():
    xml = MACHINES["arm"]
    tendon = """<tendon><fixed name="hose" stiffness="3" springlength=".15"><joint joint="elbow" coef="1"/>
        <joint joint="shoulder" coef=".7"/></fixed></tendon><actuator>"""
    effect = effects.REGISTRY.get("coupled-spring")(machine("arm"), "elbow")
    assert [p.unit for p in effect.parameters] == ["N m/rad", "1", "rad"]
    seen, _ = run(machine("arm"), (effect, np.array([[3.0, 0.7, 0.15]])))
    expected, _ = run(build(xml.replace("<actuator>", tendon)))
    assert np.abs(expected - plain("arm")).max() > 1e-2
    np.testing.assert_allclose(seen, expected, atol=1e-9)


def test_a_body_that_loses_mass_moves_as_one_that_is_weighed_anew_at_every_step():
    model, rate = machine("arm"), -0.3
    effect = effects.REGISTRY.get("mass-change")(model, "fore")
    seen, _ = run(model, (effect, np.array([[rate]])))
    lighter, tape, begin = build(ARM), controls(model, 1)[0], start(model, 1)
    mass, inertia = lighter.body("fore").mass[0], lighter.body("fore").inertia.copy()
    data, rows = mujoco.MjData(lighter), []
    data.qpos[:], data.qvel[:] = begin.qpos[0], begin.qvel[0]
    for ctrl in tape:
        growth = 1 + rate * (begin.time[0] + data.time)  # the episode began at 0
        lighter.body("fore").mass, lighter.body("fore").inertia = mass * growth, inertia * growth
        mujoco.mj_setConst(lighter, mujoco.MjData(lighter))
        data.ctrl[:] = ctrl
        mujoco.mj_step(lighter, data)
        rows.append(data.sensordata.copy())
    assert np.abs(plain("arm")[0] - rows).max() > 1e-3
    np.testing.assert_allclose(seen[0], rows, atol=1e-9)
    effect.look_in(SeenLog(window=1.0, longest=40.0, logged=frozenset(), seen={}))
    assert effect.parameters[0].high == pytest.approx(0.02), "a fifth is left at the end"


def test_a_sensor_at_a_shifted_site_shows_what_is_there():
    """A marker 2 cm farther out moves that much farther; none at a site that drives, nor along the only axis."""
    model = machine("arm")
    effect = effects.REGISTRY.get("site-shift")(model, "hand")
    assert [p.name for p in effect.parameters] == ["x", "z"], "all turns about y"
    seen, _ = run(model, (effect, np.array([[0.02, -0.01]])))
    moved = build(MACHINES["arm"])
    moved.site_pos[0] += 0.02, 0.0, -0.01
    np.testing.assert_array_equal(seen, run(moved)[0])
    effect.look_in(SeenLog(window=1.0, longest=1.0, logged=frozenset({0, 1}), seen={}))
    assert not effect.shows, "the log has the joints alone"
    effect.look_in(SeenLog(window=1.0, longest=1.0, logged=frozenset({0, 1, 3}), seen={}))
    assert effect.shows
    assert not effects.REGISTRY.get("site-shift").sites(machine("drone")), "its sites are those of rotors"


def test_a_link_may_be_longer_than_modelled():
    model = machine("arm")
    effect = effects.REGISTRY.get("body-shift")(model, "fore")
    assert effect.sites(model) == ["fore"] and not effect.sites(machine("cart_pole")), "no joint turns a cart"
    seen, _ = run(model, (effect, np.array([[0.03, 0.0]])))
    longer = build(MACHINES["arm"].replace('name="fore" pos=".4 0 0"', 'name="fore" pos=".43 0 0"'))
    np.testing.assert_allclose(seen, run(longer)[0], atol=1e-12)
    loop = MACHINES["arm"].replace(
        "<actuator>", '<equality><connect body1="fore" anchor=".3 0 0"/></equality><actuator>'
    )
    assert not effect.sites(build(loop))


def test_a_frame_is_turned_in_the_plane_and_in_space():
    effect = effects.REGISTRY.get("sensor-frame-rotation")
    plane = effect(machine("puck"), "px+py").measure(np.array([[[1.0, 0.0]]]), np.array([[0.3]]), 1.0)
    assert np.allclose(plane, [[[np.cos(0.3), np.sin(0.3)]]])
    sensors = np.arange(1.0, 11.0)[None, None] / 10
    sensors[..., 3:7] = 1, 0, 0, 0
    turn = np.array([[0.0, 0.0, 0.2]])
    assert np.allclose(
        effect(machine("ball"), "attitude").measure(sensors, turn, 1.0)[0, 0, 3:7],
        [np.cos(0.1), 0, 0, np.sin(0.1)],
    )
    x, y, z = effect(machine("ball"), "ball").measure(sensors, turn, 1.0)[0, 0, :3]
    assert np.allclose(
        [x, y, z], [0.1 * np.cos(0.2) - 0.2 * np.sin(0.2), 0.1 * np.sin(0.2) + 0.2 * np.cos(0.2), 0.3]
    )


def test_an_attitude_is_turned_in_the_world_or_on_its_body():
    from scipy.spatial.transform import Rotation

    model, turn = machine("ball"), np.array([[0.2, -0.1, 0.05]])
    true, by = Rotation.from_rotvec([0.5, 1.0, -0.4]), Rotation.from_rotvec(turn[0])
    sensors = np.zeros((1, 1, model.nsensordata))
    sensors[0, 0, 3:7] = true.as_quat()[[3, 0, 1, 2]]
    for name, seen in (("sensor-frame-rotation", by * true), ("sensor-mount-rotation", true * by)):
        effect = effects.REGISTRY.get(name)(model, "attitude")
        reported = effect.measure(sensors, turn, 1.0)[0, 0, 3:7]
        assert np.allclose(reported, seen.as_quat()[[3, 0, 1, 2]])


def test_an_imu_that_is_askew_tells_all_in_its_own_frame():
    """What MuJoCo's own sensors report at a site that is turned by as much."""
    xml = """<mujoco><worldbody><body pos="0 0 1"><freejoint/><geom type="box" size=".1 .2 .3" mass="1"/>
      <site name="imu" quat="{quat}" pos=".05 .02 -.03"/></body></worldbody><sensor>
      <framequat name="attitude" objtype="site" objname="imu"/><gyro name="gyro" site="imu"/>
      <accelerometer name="shock" site="imu"/><framepos name="place" objtype="site" objname="imu"/>
      </sensor></mujoco>"""
    turn = np.array([[0.2, -0.1, 0.05]])
    quat = np.zeros(4)
    mujoco.mju_axisAngle2Quat(quat, turn[0] / np.linalg.norm(turn[0]), np.linalg.norm(turn[0]))
    reports = []
    for turned in ("1 0 0 0", " ".join(map(str, quat))):
        model = mujoco.MjModel.from_xml_string(xml.format(quat=turned))
        data = mujoco.MjData(model)
        data.qvel[:] = 0.3, -0.2, 0.1, 2.0, 1.0, -1.5
        data.qpos[3:7] = 0.5, 0.5, -0.5, 0.5
        mujoco.mj_forward(model, data)
        reports.append(data.sensordata.copy())
    effect = effects.REGISTRY.get("sensor-mount-rotation")
    assert effect.sites(model) == ["attitude", "attitude+gyro+shock"]
    imu = effect(model, "attitude+gyro+shock")
    told = imu.measure(reports[0][None, None], turn, 1.0)[0, 0]
    assert np.allclose(told, reports[1])
    derivatives = np.repeat(reports[1][None, None], 3, axis=1)
    assert np.allclose(imu.true_motion(derivatives, turn)[0], reports[0])


def test_lift_is_perpendicular_to_spin_and_flight():
    effect = effects.REGISTRY.get("magnus-lift")(machine("ball"), "ball")
    lift = 0.005
    tape = np.zeros((1, 2, 0))
    # flying along x, spinning about y in a body frame that is turned half round about z
    begin = start(machine("ball"), 1)
    begin.qpos[:, 3:7] = 0, 0, 0, 1
    begin.qvel[:, :6] = 2, 0, 0, 0, -10, 0
    steps = [
        run(machine("ball"), (effect, np.array([[k]])), tape=tape, initial=begin)[0] for k in (0.0, lift)
    ]
    rise = (steps[1] - steps[0])[0, 1, :3] / machine("ball").opt.timestep ** 2
    assert np.allclose(rise, np.cross([0, 10, 0], [2, 0, 0]) * lift / 0.05, atol=1e-6)


def test_a_wheel_in_a_free_body_turns_it_as_one_that_is_modelled():
    """The momentum of a part that spins is what a body with that part in it, spinning freely, feels."""
    body = """<body name="b" pos="0 0 1"><freejoint name="f"/>
      <geom type="box" size="0.1 0.08 0.05" mass="1"/>{wheel}</body>"""
    wheel = """<body><joint name="spin" type="hinge" axis="0 1 0"/>
      <geom type="cylinder" size="0.04 0.01" euler="90 0 0" mass="0.2"/></body>"""
    locked = wheel.replace('<joint name="spin" type="hinge" axis="0 1 0"/>', "")
    xml = "<mujoco><option timestep='0.0005' gravity='0 0 0'/><worldbody>{body}</worldbody></mujoco>"
    with_wheel, plain = (
        mujoco.MjModel.from_xml_string(xml.format(body=body.format(wheel=w))) for w in (wheel, locked)
    )
    speed, turning = 300.0, [0.5, 0.0, 0.3]
    truth = mujoco.MjData(with_wheel)
    truth.qvel[3:7] = [*turning, speed]
    held = mujoco.MjData(plain)
    held.qvel[3:6] = turning
    effect = effects.REGISTRY.get("internal-momentum")(plain, "b")
    axial = 0.2 * 0.04**2 / 2
    momentum = np.array([[0.0, axial * speed, 0.0]])
    force = effect.force(momentum, 0.0005)
    initial = InitialStates(held.qpos[None], held.qvel[None], np.zeros((1, 0)), np.zeros(1))
    rollout = Engine(plain, 1).rollout(
        initial=initial, controls=np.zeros((1, 400, 0)), forces=[force], keep=Keep(states=True)
    )
    for _ in range(400):
        mujoco.mj_step(with_wheel, truth)
    np.testing.assert_allclose(rollout.qpos[0, -1, 3:7], truth.qpos[3:7], atol=2e-3)
    assert np.abs(truth.qpos[3:7] - rollout.qpos[0, 0, 3:7]).max() > 0.02


def test_a_spindle_between_hinges_turns_them_as_one_that_is_modelled():
    """A wrist of three hinges that are not at right angles, with a tool that spins and is modelled in the truth."""
    wrist = """<mujoco><option timestep='0.0005' gravity='0 0 0'/><default><joint damping="0.02"/></default><worldbody>
      <body name="a"><joint axis="0 0 1"/><geom type="box" size="0.1 0.08 0.05" mass="1"/>
      <body name="b" pos="0.2 0 0"><joint axis="0 1 0.2"/><geom type="box" size="0.1 0.03 0.05" mass="0.5"/>
      <body name="tool" pos="0.2 0 0"><joint axis="1 0.3 0"/><geom type="box" size="0.03 0.05 0.02" mass="0.2"/>
      <body><joint axis="0 0 1" damping="0"/><geom type="cylinder" size="0.04 0.01" mass="0.2"/></body>
      </body></body></body></worldbody></mujoco>"""
    spinning = build(wrist)
    locked = build(wrist.replace('<joint axis="0 0 1" damping="0"/>', ""))
    speed, turning = 300.0, np.array([0.5, -0.8, 0.6])
    truth = mujoco.MjData(spinning)
    truth.qvel[:] = [*turning, speed]
    motion = []
    for _ in range(400):
        motion.append(truth.qpos[:3].copy())
        mujoco.mj_step(spinning, truth)
    effect = effects.REGISTRY.get("internal-momentum")
    assert effect.sites(locked) == ["b", "tool"]
    momentum = np.array([[0.0, 0.0, 0.2 * 0.04**2 / 2 * speed], [0.0, 0.0, 0.0]])
    initial = InitialStates(np.zeros((2, 3)), np.stack([turning] * 2), np.zeros((2, 0)), np.zeros(2))
    rollout = Engine(locked, 1).rollout(
        initial=initial,
        controls=np.zeros((2, 400, 0)),
        forces=[effect(locked, "tool").force(momentum, 0.0005)],
        keep=Keep(states=True),
    )
    off = np.abs(rollout.qpos - np.array(motion)).max(axis=(1, 2))
    assert off[1] > 0.02 and off[0] < 0.02 * off[1]


def test_a_part_that_spins_inside_does_no_work():
    body = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody><body name="b"><freejoint/>
      <geom type="box" size="0.1 0.08 0.05" mass="1"/></body></worldbody></mujoco>"""
    body = build(body)
    effect = effects.REGISTRY.get("internal-momentum")(body, "b")
    force = effect.force(np.array([[0.0, 0.0, effect.parameters[2].high]]), 0.002)
    nods = InitialStates(body.qpos0[None], np.array([[0.0, 0, 0, 0.5, 0, 0]]), *NOTHING)
    tape = np.zeros((1, 500, 0))
    motion = Engine(body).rollout(initial=nods, controls=tape, forces=[force], keep=Keep(states=True))
    turning = motion.qvel[0, :, 3:]
    energy = np.square(turning) @ body.dof_M0[3:] / 2
    assert energy == pytest.approx(np.full(500, energy[0]), rel=0.01)


def test_a_part_that_slides_in_a_body_carries_its_momentum_as_that_body_does():
    head = """<mujoco><worldbody>
      <body name="pan"><joint axis="0 0 1"/><geom size="0.1" mass="1"/>
      <body name="tilt"><joint axis="0 1 0"/><geom size="0.1" mass="1"/>
      <body name="zoom"><joint type="slide" axis="1 0 0"/><geom size="0.05" mass="0.1"/></body>
      </body></body></worldbody></mujoco>"""
    assert effects.REGISTRY.get("internal-momentum").sites(build(head)) == ["tilt"]


@pytest.mark.parametrize(
    ("name", "where", "beyond"),
    [("one-sided-spring", "position", 0.0), ("position-dependent-friction", "centre", 1.75)],
)
def test_what_sits_at_a_position_may_sit_wherever_the_log_went(name, where, beyond):
    """A joint without limits turns further than the 1 rad that is taken for its travel otherwise. A rough patch shows
    by its flank from beyond.
    """
    effect = effects.REGISTRY.get(name)(machine("arm"), "elbow")
    effect.seen = JointMotion(-6.0, 1.0, 2.0)
    position = effect.parameters[effect.space.names.index(where)]
    assert (position.low, position.high) == (-6.0 - beyond, 1.0 + beyond)


def test_a_spring_may_rest_where_it_is_all_but_a_constant_force_and_be_as_stiff_as_any():
    """A counterweight's spring that is stretched tenfold; of a log that moves little the force sets the end."""
    spring, other = (
        effects.REGISTRY.get(n)(machine("arm"), "elbow") for n in ("preloaded-spring", "linear-stiffness")
    )
    everywhere = spring.parameters[1]
    spring.seen = other.seen = JointMotion(-0.1, 0.3, 2.0)
    stiffness, rest = spring.parameters
    assert stiffness.high == pytest.approx(other.parameters[0].high)
    assert -rest.low == rest.high > 4 * everywhere.high and rest.high > 10 * 0.2


def test_a_spring_may_rest_beyond_where_the_log_went_and_push_away_from_there():
    """Ropes of a lift, whose weight changes sides: 2.9 N/m away from the middle of its shaft."""
    shaft = build(
        '<mujoco><option gravity="0 0 0"/><worldbody><body name="car"><joint name="car" type="slide" axis="0 0 1"/>'
        '<geom size=".5" mass="400"/></body></worldbody></mujoco>'
    )
    effect = effects.REGISTRY.get("preloaded-spring")(shaft, "car")
    effect.seen = JointMotion(0.3, 8.6, 2.0)
    stiffness, rest = effect.parameters
    assert stiffness.low < -2.9 and rest.low < 0.3 - 4 and rest.high > 8.6 + 4
    fields = ModelFields(shaft, 1)
    effect.write(fields, np.array([[-2.9, 4.5]]))
    assert (fields["jnt_stiffness"][0, 0], fields["qpos_spring"][0, 0]) == (-2.9, 4.5)
