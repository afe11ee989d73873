"""Screening: the planted effect comes first with its size, nothing comes where nothing is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from balances import Made
from case_logs import log_of
from coloured_noise import coloured
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, lfilter
from setting_numbers import set_numbers

from benchmarks._planted_logs.cases import PLANTED, Case
from benchmarks._planted_logs.dresses import CUTOFF, DRESSES, FILTERED
from benchmarks._planted_logs.machines import MACHINE
from capture_cli.common import processes
from capture_cli.errors import LogError
from capture_cli.estimate.balance.balanced_model import BalancedModel
from capture_cli.estimate.balance.motion import SmoothedLog
from capture_cli.estimate.balance.regression import Sums, additions, best_pairs, predicted
from capture_cli.estimate.balance.screening import Screening
from capture_cli.estimate.prepare import prepare
from capture_cli.log.white_noise import noise_and_spacing
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.placed import Placed
from capture_cli.select.candidates import all_candidates
from capture_cli.select.search.beam import BeamSettings, Level, grown

# small: columns are taken where the declared parameters fit best without the effect, and a large one bends those
CASES = [
    ("slider", "quadratic-drag", "x", 0.5),
    ("slider", "control-delay", "drive", 0.02),
    ("slider", "sensor-bias", "q", 0.05),
    ("cart_pole", "constant-force", "theta", 0.01),
    ("cart_pole", "coulomb-friction", "x", 0.02),
]
DIFFERENT = 0.98  # cosine of responses above which a log hardly tells two effects apart


@pytest.mark.parametrize(("machine", "name", "site", "share"), CASES)
def test_what_was_planted_comes_first_with_its_size(machine, name, site, share):
    own = Made.of(machine, (name, site, share), episodes=2)
    _, values = own.planted[0]
    found = own.screening().additions((), ())
    (right,) = [a for a in found if a.placed.kind == name and a.placed.effect.site == site]
    best = found[0]
    cosine = best.response @ right.response
    cosine /= np.linalg.norm(best.response) * np.linalg.norm(right.response)
    assert right is best or abs(cosine) > DIFFERENT, [a.placed.name for a in found[:3]]
    assert right.gain > 15
    np.testing.assert_allclose(right.model.values[0], values, rtol=0.05, atol=1e-9)


def test_a_limit_is_found_that_the_force_seldom_reaches():
    """Most of its range does nothing in this log: the motor asks for 30 N, and could be limited anywhere up to 120."""
    own = Made.of("slider", ("torque-speed-limit", "drive", 0.82), episodes=4)
    _, (stall, _) = own.planted[0]
    best = own.screening().additions((), ())[0]
    assert best.placed.name == "torque-speed-limit@drive" and best.gain > 50
    assert best.model.values[0][0] == pytest.approx(stall, rel=0.05)


def test_a_limit_that_one_block_alone_reaches_shows_at_first_sight():
    """Fitted to the others its coefficient would be anything, were it not about 1."""
    name = "actuator-force-limit@tilt"
    case = Case(PLANTED, "pan_tilt", (name,), 3.0, 1866235701)
    (found,) = screening_of_case(case, [0.763], name).additions((), (), 0)
    assert found.gain > 100


@pytest.mark.parametrize("machine", ["slider", "cart_pole"])
def test_nothing_comes_where_nothing_is_missing(machine):
    found = Made.of(machine, episodes=4).screening().additions((), ())
    assert not [a.placed.name for a in found if a.gain > max(3 * a.error, 15)]


def test_behind_a_loggers_filter_samples_are_taken_that_have_noise_of_their_own():
    """The filter is an effect on the sensor; taken for white, its noise would show the most."""
    own = Made.of("slider", episodes=4)
    log = DRESSES[FILTERED](own.log).arrays
    smoothed = SmoothedLog.of(log, own.experiment.task)
    (placed,) = [p for p in own.placed if p.name == "sensor-second-order-low-pass@q"]
    (found,) = Screening.of(smoothed, [placed], own.truth, 1).additions((), ())
    assert found.gain > 3 * found.error and found.model.beyond_noise < 0.5
    time_constant, damping_ratio = found.model.values[0]
    late = np.sqrt(2) / (2 * np.pi * CUTOFF) * np.diff(log.time[:2])[0]  # 2 damping_ratio time_constant
    assert 2 * damping_ratio * time_constant == pytest.approx(late, rel=0.1)


def test_threads_change_no_bit(monkeypatch):
    set_numbers(monkeypatch, processes, worth=0.0)  # copies of this process work on all that they can
    own = Made.of("cart_pole", ("control-lag", "drive", 0.12), episodes=2)
    few = [
        p for p in own.placed if p.kind in ("control-lag", "control-delay", "coulomb-friction", "backlash")
    ]

    def asked(threads):
        screening = own.screening(few, threads)
        levels = [m for level in grown(screening, (), (), 2) for m in (*level.as_good, *level.others)]
        return screening.additions((), ()), levels

    (one, levels), (two, others) = asked(1), asked(3)
    for a, b in zip(one, two, strict=True):
        assert (a.placed, a.gain, a.error) == (b.placed, b.gain, b.error)
        np.testing.assert_array_equal(a.model.start, b.model.start)
        np.testing.assert_array_equal(a.response, b.response)
    assert len(levels) > len(few)
    for a, b in zip(levels, others, strict=True):
        assert a.effects == b.effects
        np.testing.assert_array_equal(a.start, b.start)
        np.testing.assert_array_equal(a.likelihood, b.likelihood)


def test_what_was_asked_before_changes_nothing():
    own = Made.of("slider", ("coulomb-friction", "x", 0.3), episodes=2)
    few = [p for p in own.placed if p.kind in ("coulomb-friction", "viscous-friction", "sensor-bias")]
    asked, fresh = own.screening(few), own.screening(few)
    asked.additions((few[0],), (few[0].effect.space.nominal,))
    list(grown(asked, (few[0],), (few[0].effect.space.nominal,), 2))
    for a, b in zip(asked.additions((), ()), fresh.additions((), ()), strict=True):
        assert (a.placed, a.gain, a.error) == (b.placed, b.gain, b.error)
    one, other = (a.model for a in fresh.additions((), ())[:2])
    fresh.whitening.reset()
    first, _, again = (fresh.fits.fitted(m) for m in (one, other, one))
    np.testing.assert_array_equal(first.start, again.start)


def test_a_log_in_which_no_effect_moves_anything_has_no_additions():
    assert Made.of("slider", episodes=2).screening([]).additions((), ()) == []


def _refitted(target, columns, block, leave, expected):
    """The maximum a posteriori by least squares with the prior as rows; expected: of the last coefficients."""
    keep = block != leave
    rows = np.vstack([columns[keep], np.eye(columns.shape[1])])
    about = np.append(np.zeros(columns.shape[1] - len(expected)), expected)
    return np.linalg.lstsq(rows, np.append(target[keep], about), rcond=None)[0]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), own=st.integers(0, 3), models=st.integers(1, 4), added=st.integers(1, 3))
def test_additions_are_what_refits_one_by_one_give(seed, own, models, added):
    generator = np.random.default_rng(seed)
    rows, blocks = 60, 5
    block = np.sort(np.append(np.arange(blocks), generator.integers(0, blocks, rows - blocks)))
    target, base = generator.standard_normal(rows), 3 * generator.standard_normal((rows, own))
    more = 3 * generator.standard_normal((rows, models, added))
    expected = generator.integers(0, 3, (models, added)).astype(float)
    sums, parts = Sums.of(target, base, block), [np.flatnonzero(block == b) for b in range(blocks)]
    gain = additions(
        sums,
        np.array([np.einsum("ri,rma->ima", base[p], more[p]) for p in parts]),
        np.array([np.einsum("rma,rmc->mac", more[p], more[p]) for p in parts]),
        np.array([np.einsum("r,rma->ma", target[p], more[p]) for p in parts]),
        expected,
    )

    def errors(columns, about=()):
        fits = [_refitted(target, columns, block, b, about) for b in range(blocks)]
        return np.array(
            [np.square(target[p] - columns[p] @ f).sum() for p, f in zip(parts, fits, strict=True)]
        )

    np.testing.assert_allclose(predicted(sums), errors(base), rtol=1e-8)
    for m in range(models):
        whole = np.hstack([base, more[:, m]])
        gains = 0.5 * sums.count * np.log(errors(base) / errors(whole, expected[m]))
        assert gain.mean[m] == pytest.approx(gains.sum(), rel=1e-6, abs=1e-8)
        assert gain.error[m] == pytest.approx(gains.std(ddof=1) * np.sqrt(blocks), rel=1e-6)
        refitted = _refitted(target, whole, block, -1, expected[m])
        np.testing.assert_allclose(gain.coefficients[m], refitted, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), effects=st.integers(2, 7), count=st.integers(1, 5))
def test_the_best_pairs_are_those_that_leave_least_one_by_one(seed, effects, count):
    generator = np.random.default_rng(seed)
    responses, target = 3 * generator.standard_normal((effects, 40)), generator.standard_normal(40)

    def left(pair):
        columns = responses[list(pair)].T
        rows, prior = np.vstack([columns, np.eye(2)]), np.append(target, np.zeros(2))
        return np.square(prior - rows @ np.linalg.lstsq(rows, prior, rcond=None)[0]).sum()

    every = sorted(combinations(range(effects), 2), key=left)
    assert best_pairs(responses, target, np.ones(effects), 1.0, count) == every[:count]


def test_two_that_stand_in_each_others_way_are_a_pair_and_two_that_are_alike_are_none():
    generator = np.random.default_rng(0)
    one, third, noise = generator.standard_normal((3, 2000))
    other = one + 0.3 * noise
    responses = np.array([one, other, third, third + 1e-3 * noise])
    target = 5 * (one - other) + 0.1 * third  # of which neither shows alone
    sizes = np.ones(4)
    assert best_pairs(responses, target, sizes, 0.99, 1) == [(0, 1)]
    found = best_pairs(responses, target, sizes, 0.99, 10)
    assert (2, 3) not in found and sum({2, 3} & set(pair) != set() for pair in found) == 2


def screening_of_case(case: Case, sizes: Sequence[float], *names: str) -> Screening:
    """Of these effects, NAME@SITE, in the log of a case with effects of these sizes."""
    task, log = log_of(case, *sizes)
    prepared = prepare(log, task)
    placed = [c.placed for c in all_candidates(prepared) if c.name in names]
    return Screening.of(SmoothedLog.of(prepared.log.arrays, prepared.task), placed, task.space.nominal, 1)


def additions_of(case: Case, size: float, *names: str) -> dict[str, float]:
    """Gains of these effects in the log of a case."""
    return {a.placed.name: a.gain for a in screening_of_case(case, [size], *names).additions((), ())}


def test_a_spring_that_needs_both_of_its_sides_is_asked_of_each():
    """By the declared stiffness, which is at its bound, one of the two would be negative at every place."""
    name = "one-sided-spring@x"
    assert additions_of(Case(PLANTED, "slider", (name,), 3.0, 543295301), 0.00108, name)[name] > 100


def test_a_control_that_its_limits_cut_off_is_asked_both_ways():
    """At its limit a motor takes up no more: what a bias adds is not the reverse of what it takes away."""
    made = Made.of("finger", ("control-bias", "root", -0.1), episodes=3)
    assert np.abs(made.balance.controls[:, 1]).max() > 0.99 * 0.1
    few = [p for p in made.placed if p.name in ("control-bias@root", "constant-force@mcp")]
    screening = made.screening(few)
    found = {
        a.placed.name: a.gain
        for a in screening.screened(screening.fits.fitted(BalancedModel((), made.truth, ())))
    }
    assert found["control-bias@root"] > found["constant-force@mcp"] > 100


def test_a_declared_parameter_that_is_at_its_bound_takes_nothing_from_an_effect():
    found = additions_of(
        Case(PLANTED, "slider", ("medium-viscosity",), 2.2, 1385089885, episodes=6),
        0.485,
        "medium-viscosity",
        "coulomb-friction@x",
    )
    assert 100 < found["medium-viscosity"] < 1e4 and found["medium-viscosity"] > found["coulomb-friction@x"]


def test_slow_noise_of_sensors_is_none_of_the_model():
    """What is forgotten within some samples weighs less where motion is slow, and so does not hide friction there."""
    made = Made.of("slider", ("coulomb-friction", "x", 0.1), episodes=6)
    log = made.experiment.log(made.experiment.outputs(made.planted))
    ends = [e.stop - e.start for e in log.episodes]
    noise = coloured((len(ends), ends[0]), np.random.default_rng(1), sd=1e-3, memory=8.0).reshape(-1, 1)
    prepared = prepare(replace(log, outputs=log.outputs + noise), made.experiment.task)
    placed = [c.placed for c in all_candidates(prepared) if c.placed.kind == "coulomb-friction"]
    smoothed = SmoothedLog.of(prepared.log.arrays, prepared.task)
    own = Screening.of(smoothed, placed, prepared.task.space.nominal, 1)
    (found,) = own.additions((), ())
    assert own.whitening.slow_noise.max() > 0.5
    assert found.gain > 5 * found.error > 0


def test_two_effects_are_found_of_which_a_third_does_more_than_either():
    own = Made.of("slider", ("coulomb-friction", "x", 0.3), ("sensor-bias", "q", 0.2), episodes=4)
    few = [
        p for p in own.placed if p.kind in ("coulomb-friction", "sensor-bias", "cogging", "viscous-friction")
    ]
    pairs = list(grown(own.screening(few), (), (), 3))[-1].as_good
    # where the spring is pulled aside by a bias, and where by a force of a long period, is nearly the same
    assert ["coulomb-friction", "sensor-bias"] in [sorted(e.kind for e in m.effects) for m in pairs]
    alone = Made.of("slider", ("coulomb-friction", "x", 0.3), episodes=4)
    (level,) = grown(alone.screening(few), (), (), 3)
    best = level.as_good[0]
    assert [e.kind for e in best.effects] == ["coulomb-friction"]


def test_a_model_that_no_descent_got_to_is_as_likely_as_it_is():
    """Two springs on one joint: to first order they do as a third that is far from either."""
    own = Made.of("cart_pole", ("coupled-spring", "theta", 0.01), episodes=4)
    both = [p for p in own.placed if p.name in ("coupled-spring@theta", "preloaded-spring@theta")]
    fits = own.screening(both).fits
    values = (np.array([0.046, 0.167, -0.036]), np.array([-0.008, -0.105]))
    begun = BalancedModel(tuple(both), own.truth, values)
    promised, found = fits.judged(begun), fits.fitted(begun)
    assert promised.at_values.sum() < promised.likelihood.sum() - 1e3
    assert found.at_values.sum() > promised.at_values.sum() + 1e3
    assert found.likelihood.sum() <= found.at_values.sum()


def test_a_pair_is_found_of_which_one_is_not_among_the_best_alone():
    """Before a gear's coupling come more single effects than are grown."""
    pair = ("coupled-drive@tilt", "viscoelastic-spring@pan")
    others = ("preloaded-spring", "cogging", "one-sided-spring", "sensor-eccentricity", "hysteretic-friction")
    case = Case("pair", "pan_tilt", pair, 3.0, 1224827016, episodes=6)
    screening = screening_of_case(case, (0.03, 0.00912), *pair, *(f"{kind}@pan" for kind in others))
    ranked = [a.placed.name for a in screening.additions((), ())]
    assert ranked.index("coupled-drive@tilt") >= BeamSettings().width
    *_, level = grown(screening, (), (), 2)
    assert {e.name for e in level.as_good[0].effects} == set(pair)
    assert {e.name for e in screening.pairs((), (), 1)[0].effects} == set(pair)


def test_a_payload_shows_by_several_masses_where_none_alone_does_it(monkeypatch):
    """With the camera's own mass open no one place of the grid has its moment and its inertia."""
    made = screening_of_case(
        Case(PLANTED, "pan_tilt", ("payload@camera",), 2.2, 252784246), [0.122], "payload@camera"
    )
    with monkeypatch.context() as patch:
        patch.setattr(REGISTRY.get("payload"), "mixes", False)
        (alone,) = Screening(made.balance, made.whitening, made.placed).additions((), (), 0)
    (together,), (polished,) = made.additions((), (), 0), made.additions((), ())
    assert together.gain > 1.3 * alone.gain
    assert polished.gain > 1.3 * together.gain


def test_a_fit_begins_where_the_balance_is_met_not_where_it_promises_to_be():
    """A spring that pushes away: to first order one that pulls, and rests on the other side, promises as much."""
    made = Made.of("pan_tilt", seed=5)
    spring = REGISTRY.get("preloaded-spring")(made.experiment.task.model, "tilt")
    own = Made(made.experiment, [(spring, np.array([-0.3, 0.36]))])
    (found,) = own.screening([p for p in own.placed if p.name == "preloaded-spring@tilt"]).additions((), ())
    assert found.elsewhere
    np.testing.assert_allclose(found.model.values[0], [-0.3, 0.36], rtol=0.1)


def test_a_declared_parameter_that_was_driven_to_its_end_is_led_back():
    """The upper arm's mass falls to its lower bound for want of its centre of mass, with which it makes one moment."""
    case = Case(PLANTED, "arm", ("com-shift@upper",), 10.0, 1352802202)
    made = screening_of_case(case, [0.558], "com-shift@upper")
    (found,) = made.additions((), ())
    assert made.balance.point[0] == made.fits.space.low[0] < 0.5 < found.model.point[0]


def test_a_law_that_all_joints_lack_is_found_at_all_of_them():
    shares = (("shoulder", 0.05), ("elbow", 0.05))
    own = Made.of("arm", *(("coulomb-friction", joint, share) for joint, share in shares), episodes=4)
    few = [p for p in own.placed if p.kind in ("coulomb-friction", "viscous-friction")]
    best = list(grown(own.screening(few), (), (), 3))[-1].as_good[0]
    assert {e.name for e in best.effects} == {f"coulomb-friction@{joint}" for joint, _ in shares}


def test_about_a_late_sensor_the_friction_beside_it_comes_first_with_its_size():
    own = Made.of("arm", ("sensor-delay", "q2", 0.08), ("coulomb-friction", "shoulder", 0.02), episodes=2)
    (delay, late), (_, friction) = own.planted
    found = [Placed("sensor-delay", delay)], [late]
    kinds = ("coulomb-friction", "cogging", "payload", "reflected-inertia", "sensor-low-pass", "control-lag")
    declared = own.screening([p for p in own.placed if p.kind in kinds])
    far = declared.additions(*found)[0]
    best = declared.about(own.truth, *found).additions(*found)[0]
    assert far.placed.name != "coulomb-friction@shoulder"
    assert best.placed.name == "coulomb-friction@shoulder"
    np.testing.assert_allclose(best.model.values[1], friction, rtol=0.05)
    np.testing.assert_allclose(best.model.values[0], late, rtol=0.02)


def test_about_a_model_that_runs_away_along_the_log_there_is_no_balance():
    own = Made.of("slider", episodes=2)
    (compliance,) = [p for p in own.placed if p.name == "compliance@x"]
    values = {"compliance": 4.7e-3, "rotor": 1.98, "motor_damping": 0.83, "damping_time": 0.02}
    with pytest.raises(LogError, match="compliance@x the model runs away"):
        own.screening([compliance]).about(
            own.truth, [compliance], [compliance.effect.space.to_vector(values)]
        )


@pytest.mark.parametrize(("machine", "number"), [("cart_pole", 97227738), ("pan_tilt", 381654049)])
def test_behind_one_filter_the_floors_of_all_sensors_are_those_of_their_noise(machine, number):
    """One of the two seems to have noise of its own three samples on, of which it has 0.89 there; the other, four."""
    task, log, _ = Case("nothing", machine, (), None, number, FILTERED).build()
    sd = np.array([MACHINE[machine].noise[c.name] for c in task.outputs])
    arrays = log.arrays
    series = [[arrays.outputs[e, k] for e in arrays.episodes] for k in range(len(sd))]
    times = [[arrays.time[e] for e in arrays.episodes]] * len(sd)
    left = np.linalg.norm(lfilter(*butter(2, 2 * CUTOFF), np.eye(1, 1000)[0]))  # of white noise
    floors = [noise for noise, _ in noise_and_spacing(series, times)]
    np.testing.assert_allclose(floors, left * sd, rtol=0.05)


def test_effects_that_are_alike_alone_take_each_others_place_beside_another():
    """A delay and a lag do the same as long as a bias is missing, too: alone the lag may be ahead."""
    own = Made.of("arm", ("control-delay", "shoulder", 0.1), ("sensor-bias", "q1", 0.2), episodes=2)
    few = [p for p in own.placed if p.kind in ("control-delay", "control-lag", "sensor-bias", "cogging")]
    level = list(grown(own.screening(few), (), (), 2))[-1]
    names = [{e.name for e in m.effects} for m in (*level.as_good, *level.others)]
    assert names[0] == {"control-delay@shoulder", "sensor-bias@q1"}
    assert {"control-lag@shoulder", "sensor-bias@q1"} in names


def test_a_simpler_effect_is_fitted_that_does_nearly_the_same():
    """Two lags one after the other beside one: by columns alone it seems to do far less."""
    case = Case("planted", "pan_tilt", ("control-lag",), 10.0, 580590091, "no-window", episodes=6)
    names = "control-lag", "control-second-order-lag", "control-delay", "gravity-magnitude"
    screening = screening_of_case(case, [0.012], *names)
    best = screening.best()
    assert [e.name for e in best.effects] == ["control-second-order-lag"]
    simpler = {m.effects[0].name: m for m in screening.simpler(best)}
    assert set(simpler) == {"control-lag", "control-delay"}
    lag = simpler["control-lag"]
    assert lag.likelihood.sum() > best.likelihood.sum() - 3
    assert lag.values[0] == pytest.approx(0.006, rel=0.2)
    assert screening.simpler(lag) == []


def test_as_good_is_what_is_near_or_not_surely_worse():
    def model(*likelihood: float) -> BalancedModel:
        return BalancedModel((), np.zeros(0), (), np.array(likelihood))

    best = model(10.0, 10.0, 10.0, 10.0)
    near, worse = model(9.5, 9.5, 9.5, 9.5), model(5.0, 5.1, 4.9, 5.0)
    unsure = model(25.0, -20.0, 10.0, 5.0)
    level = Level.of([best, near, unsure, worse], 40.0, BeamSettings())
    assert level.as_good == [best, near, unsure] and level.others == [worse]
    assert Level.of([best, near], 1.0, BeamSettings(least=1.0)).others == [near]


def test_what_is_behind_is_as_good_as_the_best_of_the_others():
    """On the EMPS a friction that no simulation can do is 430 of log likelihood ahead of the one that is there."""

    def model(likelihood: float) -> BalancedModel:
        return BalancedModel((), np.zeros(0), (), np.full(4, likelihood / 4))

    ahead, true, alike, little = (model(g) for g in (1926.0, 1498.0, 1351.0, 2.0))
    level = Level.of([ahead, true, alike, little], 1926.0, BeamSettings())
    assert level.as_good == [ahead]
    behind = level.behind(BeamSettings())
    assert behind.as_good == [true, alike] and behind.others == [little]
    assert behind.behind(BeamSettings()) is None  # it predicts hardly better than without
    assert Level([], [true]).behind(BeamSettings()) is None


@pytest.mark.parametrize("length", [1.0, 1e9, 1e14])
def test_columns_that_are_the_same_share_what_they_explain_however_long_they_are(length):
    rng = np.random.default_rng(0)
    column, block = rng.standard_normal(60), np.repeat(np.arange(6), 10)
    twins = length * np.stack([column, column], axis=1)
    parts = [np.flatnonzero(block == b) for b in range(6)]
    target = column + 0.1 * rng.standard_normal(60)
    base = Sums.of(target, np.zeros((60, 0)), block)
    found = additions(
        base,
        np.zeros((6, 0, 1, 2)),
        np.array([[twins[p].T @ twins[p]] for p in parts]),
        np.array([[twins[p].T @ target[p]] for p in parts]),
        np.zeros((1, 2)),
    )
    assert (length * found.coefficients[0]).sum() == pytest.approx(1.0, abs=0.05)
    assert found.mean[0] > 50
