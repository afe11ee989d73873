"""Logs with a known answer: the same in every dress, of the size that was asked for, the same every time."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from itertools import islice

import mujoco
import numpy as np
import pytest
from balances import Made

from benchmarks._planted_logs.cases import (
    KINDS,
    NO_SIZE,
    NOTHING,
    PAIR,
    PLANTED,
    WEAK,
    WEAK_MAGNITUDES,
    Case,
    NothingToFind,
    cases,
    direction,
)
from benchmarks._planted_logs.dresses import (
    CUTOFF,
    DRESSES,
    ELSEWHERE,
    FILTERED,
    HALF,
    NO_WINDOW,
    PLAIN,
    QUARTER,
)
from benchmarks._planted_logs.machines import MACHINE, RATE, Experiment
from benchmarks._planted_logs.sizes import Refit, size
from capture_cli.model.effects import REGISTRY

EPISODES = 2
FRICTION = Case(PLANTED, "cart_pole", ("coulomb-friction@x",), 3.0, 0, episodes=EPISODES)


def built(case: Case, **changes):
    return replace(case, episodes=EPISODES, **changes).build()


@pytest.fixture(scope="module")
def plain():
    return FRICTION.build()


def test_the_error_is_the_one_asked_for_and_the_truth_makes_the_log(plain):
    task, log, truth = plain
    assert truth.shown.error == pytest.approx(3.0, rel=0.1)
    assert list(truth.effects) == ["coulomb-friction@x"]
    effect = REGISTRY.get("coulomb-friction")(task.model, "x")
    values = np.array(list(truth.effects["coulomb-friction@x"].values()))
    made = Experiment(MACHINE["cart_pole"], FRICTION.generator, EPISODES)
    assert list(truth.parameters.values()) == made.parameters.tolist()
    np.testing.assert_array_equal(log.outputs, made.outputs([(effect, values)]) + made.noise)


def test_the_same_case_is_the_same_log(plain):
    np.testing.assert_array_equal(plain[1].outputs, FRICTION.build()[1].outputs)
    assert not np.array_equal(plain[1].outputs, built(FRICTION, number=1)[1].outputs)


@pytest.mark.parametrize(("dress", "every"), [(HALF, 2), (QUARTER, 4)])
def test_slow_loggers_keep_each_so_many_th_row(plain, dress, every):
    _, log, truth = built(FRICTION, dress=dress)
    assert truth == plain[2]
    for mine, theirs in zip(log.check().episodes, plain[1].episodes, strict=True):
        for name in ("time", "inputs", "outputs"):
            np.testing.assert_array_equal(getattr(log, name)[mine], getattr(plain[1], name)[theirs][::every])


def test_a_filtering_logger_is_late_by_its_filter_and_quieter(plain):
    made = Experiment(MACHINE["cart_pole"], FRICTION.generator, EPISODES)
    _, log, _ = built(Case(NOTHING, "cart_pole", (), 1.0, 0), dress=FILTERED)
    _, same, _ = built(Case(NOTHING, "cart_pole", (), 1.0, 0))
    rough, smooth = (np.diff(one.outputs[one.episodes[0]], 4, axis=0).std() for one in (same, log))
    assert smooth < 0.2 * rough
    # a Butterworth of second order delays what is slow by sqrt(2) over its cutoff in rad/s
    delay = np.sqrt(2) / (2 * np.pi * CUTOFF * RATE)
    late = np.interp(made.time[:751] - delay, made.time[:751], same.outputs[:751, 0])
    assert np.abs(log.outputs[20:751, 0] - late[20:]).max() < 5 * made.noise_sd[0]


def test_without_a_window_the_log_is_the_same(plain):
    task, log, _ = built(FRICTION, dress=NO_WINDOW)
    assert (task.log.window, plain[0].log.window) == (None, 0.5)
    np.testing.assert_array_equal(log.outputs, plain[1].outputs)


@pytest.mark.parametrize("kind", KINDS)
def test_cases_are_the_same_in_every_dress(kind):
    drawn = {d: [replace(c, dress=PLAIN) for c in islice(cases(kind, 3, d), 12)] for d in DRESSES}
    assert all(c == drawn[PLAIN] for c in drawn.values())
    assert {c.machine for c in drawn[PLAIN]} == set(MACHINE)
    assert drawn[PLAIN] != list(islice(cases(kind, 4), 12))


def test_a_weak_effect_shows_in_a_parameter_and_hardly_in_the_error():
    case = Case(WEAK, "arm", ("cubic-drag@elbow",), 1.05, 0)
    shown = case.build()[2].shown
    low, high = WEAK_MAGNITUDES
    assert low < shown.error < high
    assert np.abs(shown.shift).max() > 5


def test_what_moves_no_output_is_nothing_to_find():
    with pytest.raises(NothingToFind, match=r"at most 1 times the noise"):
        built(Case(PLANTED, "slider", ("gravity-magnitude",), 3.0, 0))


def test_two_effects_of_a_pair_may_have_parameters_of_one_name_at_one_place():
    pair = ("control-lag@flexor", "control-second-order-lag@flexor")
    _, _, truth = built(Case(PAIR, "finger", pair, 3.0, 0))
    assert all(truth.effects[name]["time_constant"] > 0 for name in pair)


def test_nothing_missing_leaves_nothing():
    shown = built(Case(NOTHING, "finger", (), 1.0, 0))[2].shown
    assert (shown.left, np.abs(shown.shift).max()) == (0.0, 0.0)


def test_a_refit_takes_up_what_a_parameter_can_and_says_how_far_it_moved():
    made = Experiment(MACHINE["slider"], np.random.default_rng(0), EPISODES)
    refit = Refit(made)
    truth = made.parameters
    made.parameters = truth + 0.02 * made.task.space.span * [0, 1, 0]
    other = made.outputs()
    made.parameters = truth
    shown = refit.shown(other)
    assert shown.left < 1e-3
    assert shown.shift[1] > 10 > 0.1 > np.abs(np.array(shown.shift)[[0, 2]]).max()


@pytest.mark.parametrize("machine", list(MACHINE))
def test_directions_stay_within_ranges(machine):
    model = MACHINE[machine].task.model
    sited = [(name, cls) for name, cls in REGISTRY.items() if name not in NO_SIZE and cls.sites(model)]
    assert len(sited) >= 40
    for name, cls in sited:
        for site in cls.sites(model):
            effect = cls(model, site)
            values = direction(effect, np.random.default_rng(0))
            shapes = [effect.space.names.index(n) for n in effect.shapes if n in effect.space.names]
            amplitudes = np.setdiff1d(np.arange(len(effect.space)), shapes)
            np.testing.assert_array_equal(values(0.0)[amplitudes], effect.space.nominal[amplitudes], name)
            largest = values(1.0)
            assert np.all((largest >= effect.space.low) & (largest <= effect.space.high)), name


@pytest.mark.parametrize("power", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("magnitude", [1.01, 2.0, 10.0])
def test_size_reaches_the_error_asked_for(power, magnitude):
    found = size(lambda s: 40.0 * s**power, magnitude)
    assert 40.0 * found**power == pytest.approx(np.sqrt(magnitude**2 - 1), rel=0.1)


def test_size_out_of_reach_beyond_divergence_and_across_a_jump():
    assert size(lambda s: 0.2 * s, 3.0) is None
    found = size(lambda s: 1000.0 * s if s < 0.02 else np.inf, 3.0)
    assert 1000.0 * found == pytest.approx(np.sqrt(8), rel=0.1)
    assert size(lambda s: 0.0 if s < 0.02 else 50.0, 3.0) is None


# shapes that end where the log does: what is planted beyond does as another effect
ENDS_WITH_THE_LOG = {
    ("one-sided-spring", "position"),  # preloaded-spring
    ("torque-speed-limit", "no_load_speed"),  # actuator-force-limit
    ("position-dependent-friction", "centre"),  # nothing, beyond its flank
}


@pytest.mark.parametrize("machine_name", ["cart_pole", "pan_tilt", "finger"])
def test_a_shape_that_may_be_planted_is_in_the_range_of_a_log(machine_name):
    own = Made.of(machine_name, episodes=3)
    outside = set()
    for kind, effect in (p for p in own.placed if p.effect.shapes):
        anywhere = REGISTRY.get(kind)(own.experiment.task.model, effect.site)
        low, high = (
            dict(zip(effect.space.names, ends, strict=True)) for ends in (effect.space.low, effect.space.high)
        )
        for number in range(10):
            values = direction(anywhere, np.random.default_rng(number))(0.0)
            drawn = zip(anywhere.space.names, values, strict=True)
            outside |= {(kind, n) for n, v in drawn if n in effect.shapes and not low[n] <= v <= high[n]}
    assert outside <= ENDS_WITH_THE_LOG


def test_elsewhere_a_machine_moves_in_time_and_not_in_steps_of_its_model():
    case = Case(NOTHING, "arm", (), 1.0, 0, dress=ELSEWHERE)
    made = case.experiment(case.generator)
    made.parameters = made.task.space.nominal
    there = made.outputs()[:25]
    made.elsewhere = False
    own = made.outputs()[:25]
    model = copy(made.task.model)
    model.opt.integrator, steps = mujoco.mjtIntegrator.mjINT_RK4, round(1 / RATE / model.opt.timestep)
    data, moved = mujoco.MjData(model), []
    for ctrl in made.inputs[:25]:
        moved.append(data.qpos.copy())
        data.ctrl[:] = ctrl
        mujoco.mj_step(model, data, steps)
    assert np.abs(there - moved).max() < 0.2 * np.abs(own - moved).max()
