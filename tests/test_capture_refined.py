"""The refined identifier: what the transformer proposes, made exact by the simulator; here both are stand-ins."""

from __future__ import annotations

import numpy as np
import pytest
import toy_rounds
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom

from capture_cli.context.identifiers._label_refinement import LabelRefinement
from capture_cli.context.identifiers._learned import Prediction
from capture_cli.context.identifiers._refinement import _corrected
from capture_cli.context.identifiers.base import Signature, run_rounds
from capture_cli.context.identifiers.capture_refined import CaptureRefined
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.model.tasks.base import Feature

PAIRS = 8
LABELLED = Signature(
    "labelled",
    ParameterSpace([Parameter("com", "1", -1.0, 1.0, 0.0)]),
    ParameterSpace([Parameter("scoop_point", "1", -1.0, 1.0, 0.0)]),
    (Feature("label", "1", 1.0),),
    np.array([0.4]),
)


class Proposal:
    """Stands for a trained transformer: the target with an error of `sd` of the range, or what it says is known."""

    window = 7

    def __init__(self, signature: Signature, target: np.ndarray, sd: float, seed: int = 0):
        self.signature, self.sd = signature, sd
        off = sd * np.random.default_rng(seed).standard_normal(target.shape)
        self.mean = signature.space.from_unit(np.clip(signature.space.to_unit(target) + off, 0, 1))

    def predict(self, rounds) -> Prediction:
        covariance = np.diag((self.sd * self.signature.space.span) ** 2)
        return Prediction(self.mean, np.repeat(covariance[None], len(self.mean), axis=0))


def label(parameters: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The side on which the centre of mass is, or 0 near it."""
    off = parameters[:, 0] - actions[:, 0]
    return np.where(np.abs(off) < 0.05, 0.0, np.sign(off))[:, None, None], np.zeros(len(off), dtype=bool)


def identified(
    signature, simulate, act, sd=0.1, rounds=6, noise=None, seed=0, pairs=PAIRS, rough=False, **options
):
    """(walk, target, identifier) of pairs at random."""
    generator = np.random.default_rng(seed)
    source, target = signature.space.from_unit(generator.random((2, pairs, len(signature.space))))
    calls = []

    def counted(parameters, actions):
        calls.append(len(parameters))
        low, high = signature.space.low - 1e-9, signature.space.high + 1e-9
        assert ((parameters >= low) & (parameters <= high)).all()
        return simulate(parameters, actions)

    def measure(number, actions):
        measured = simulate(target, actions)[0]
        return measured if noise is None else noise(number, measured, generator)

    model = Proposal(signature, target, sd, seed)
    made = CaptureRefined(signature, source, model=model, rough=rough, simulate=counted, **options)
    walk = run_rounds(made, rounds, act=act, simulate=simulate, measure=measure)
    assert made.simulated_rollouts.sum() == sum(calls)
    return walk, target, made


def toy(**options):
    generator = np.random.default_rng(1)
    pairs = options.get("pairs", PAIRS)
    return identified(
        toy_rounds.SIGNATURE,
        toy_rounds.simulate,
        lambda number, parameters: toy_rounds.draw_actions(generator, pairs),
        **options,
    )


def error(walk, target, space) -> np.ndarray:
    """(pair, round, parameter) over the range."""
    return np.abs(walk.estimates - target[:, None]) / space.span


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10_000), sd=st.sampled_from([0.05, 0.2]))
def test_it_finds_the_target_where_the_proposal_is_off(seed, sd):
    walk, target, _ = toy(seed=seed, sd=sd)
    assert error(walk, target, toy_rounds.SIGNATURE.space)[:, -1].max() < 5e-3


def test_a_pair_that_is_found_costs_one_rollout_a_round():
    walk, _, _ = toy(rounds=9)
    assert (np.diff(walk.simulated_rollouts[:, -3:], axis=1) == 1).all()


def test_noise_is_averaged_over_rounds_and_the_interval_knows():
    def noise(number, measured, generator):
        return measured + 0.01 * generator.standard_normal(measured.shape)

    walk, target, _ = toy(rounds=12, noise=noise, pairs=24)
    off = error(walk, target, toy_rounds.SIGNATURE.space).mean(axis=(0, 2))
    assert off[-1] < 0.6 * off[1]
    covered = np.abs(walk.estimates - target[:, None]) < 1.96 * walk.sd
    assert 0.88 < covered[:, 4:].mean() <= 1.0


@pytest.mark.parametrize("grows", [True, False])
def test_intervals_hold_the_truth_whether_noise_grows_with_the_value_or_not(grows):
    def noise(number, measured, generator):
        shape = measured.shape
        if grows:
            return measured * generator.uniform(0.9, 1.1, shape)
        return measured + 0.01 * generator.standard_normal(shape)

    walk, target, made = toy(rounds=8, noise=noise, pairs=40)
    assert all(p.cloud is not None for p in made._refinement._pairs)
    held = (np.abs(walk.estimates - target[:, None])[:, -1] < 1.96 * walk.sd[:, -1]).sum()
    assert binom.cdf(held, target.size, 0.95) > 1e-3  # not too few
    assert error(walk, target, toy_rounds.SIGNATURE.space)[:, -1].mean() < 0.025
    assert walk.simulated_rollouts[:, -1].max() < 500


def test_pairs_without_noise_are_descended():
    _, _, made = toy(rounds=8)
    assert all(p.cloud is None for p in made._refinement._pairs)


def test_rough_rounds_spare_simulations_and_end_about_as_well():
    def noise(number, measured, generator):
        return measured + 0.01 * generator.standard_normal(measured.shape)

    (exact, target, _), (rough, _, _) = (
        toy(rounds=8, noise=noise, pairs=24, rough=rough) for rough in (False, True)
    )
    assert rough.simulated_rollouts[:, -1].sum() < 0.7 * exact.simulated_rollouts[:, -1].sum()
    space = toy_rounds.SIGNATURE.space
    assert error(rough, target, space)[:, -1].mean() < 1.3 * error(exact, target, space)[:, -1].mean()


def test_a_direction_that_nothing_shows_is_left_to_the_proposal():
    def half_blind(parameters, actions):
        fixed = parameters.copy()
        fixed[:, 1] = toy_rounds.SIGNATURE.space.nominal[1]
        return toy_rounds.simulate(fixed, actions)

    generator = np.random.default_rng(1)
    walk, target, made = identified(
        toy_rounds.SIGNATURE, half_blind, lambda n, p: toy_rounds.draw_actions(generator, PAIRS)
    )
    space = toy_rounds.SIGNATURE.space
    assert np.abs(space.to_unit(walk.estimates[:, -1]) - space.to_unit(target))[:, 0].max() < 5e-3
    np.testing.assert_allclose(walk.estimates[:, -1, 1], made.model.mean[:, 1], rtol=1e-3)
    np.testing.assert_allclose(walk.sd[:, -1, 1], 0.1 * space.span[1], rtol=0.35)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_what_an_output_did_not_depend_on_a_step_does_not_tell(seed):
    generator = np.random.default_rng(seed)
    j = generator.standard_normal((6, 3)) * (generator.random((6, 3)) < 0.5)
    move, change = 0.1 * generator.standard_normal(3), generator.standard_normal(6)
    corrected = _corrected(j, move, change)
    assert (corrected[j == 0] == 0).all()
    depends = (np.square(move) * (j != 0)).sum(axis=1) > 1e-4
    np.testing.assert_allclose((corrected @ move)[depends], change[depends])


def test_it_does_the_same_again():
    one, two = toy()[0], toy()[0]
    np.testing.assert_array_equal(one.estimates, two.estimates)
    np.testing.assert_array_equal(one.simulated_rollouts, two.simulated_rollouts)


def test_labels_are_bracketed():
    walk, target, _ = identified(LABELLED, label, lambda n, p: p, sd=0.2, rounds=8, pairs=40)
    assert (np.abs(walk.estimates[:, 5:, 0] - target) < 0.06).all()
    assert walk.simulated_rollouts[:, -1].max() < 200


def every_third(number, measured, generator):
    wrong = generator.integers(-1, 2, measured.shape)
    return wrong if number % 3 == 2 else measured


def test_wrong_labels_are_outvoted():
    walk, target, _ = identified(
        LABELLED, label, lambda n, p: p, sd=0.3, rounds=12, noise=every_third, pairs=60
    )
    assert (np.abs(walk.estimates[:, -1, 0] - target[:, 0]) < 0.05).mean() > 0.9


def test_labels_that_are_known_to_be_random_do_not_mislead():
    walk, target, _ = identified(
        LABELLED,
        label,
        lambda n, p: p,
        rounds=6,
        noise=every_third,
        pairs=60,
        error_rate=lambda number: 2 / 3 if number % 3 == 2 else 1e-3,
    )
    assert (np.abs(walk.estimates[:, 4, 0] - target[:, 0]) < 0.05).mean() > 0.85


@pytest.mark.parametrize("noise", [None, every_third])
def test_intervals_of_labels_hold_the_truth(noise):
    walk, target, _ = identified(LABELLED, label, lambda n, p: p, rounds=8, noise=noise, pairs=100)
    covered = np.abs(walk.estimates - target[:, None]) <= 1.96 * walk.sd
    assert 0.88 < covered[:, 4:].mean() < 0.995


@pytest.mark.parametrize("off", [-0.04, 0.04])
def test_an_action_that_is_off_is_allowed_for(off):
    """A policy that scoops beside where it is asked to: what its actions show of that is made up for."""
    walk, target, _ = identified(LABELLED, label, lambda n, p: p + off, rounds=6, pairs=150)
    scooped = walk.estimates[:, :, 0] + off
    assert (np.abs(scooped - target)[:, 5] < 0.05).mean() > 0.95


def test_what_is_asked_next_tells_most_of_the_next_estimate():
    """Held against a plain search of questions and answers."""
    error, near, pairs = 0.2, 0.025, 16  # `near` of the range, as `label` has it
    walk, *_ = identified(LABELLED, label, lambda n, p: p, pairs=pairs, rounds=4, noise=every_third)
    refinement = LabelRefinement(LABELLED, pairs, label, lambda number: error)
    refinement.recall(walk.rounds)
    posteriors = refinement._posterior()
    values = np.linspace(0, 1, posteriors.shape[1])

    def held(posterior, asked):
        side = np.where(np.abs(values - asked) < near, 0, np.sign(values - asked))
        after = [np.where(side == told, 1 - error, error / 2) * posterior for told in (-1, 0, 1)]
        return sum(max(a[np.abs(values - v) < near].sum() for v in values[::8]) for a in after)

    def worth(asked):
        return np.array([held(*each) for each in zip(posteriors, LABELLED.space.to_unit(asked), strict=True)])

    estimate = walk.estimates[:, -1]
    asked = worth(refinement.question(estimate))
    best = np.array([max(held(p, v) for v in values[::16]) for p in posteriors])
    assert (asked > 0.85 * best).all()
    assert asked.mean() > max(0.95 * best.mean(), worth(estimate).mean())


def test_a_proposal_does_not_count_labels_twice():
    one, two = (identified(LABELLED, label, lambda n, p: p, sd=sd, rounds=4)[0] for sd in (0.02, 0.5))
    np.testing.assert_array_equal(one.estimates, two.estimates)


def test_it_needs_a_simulator():
    with pytest.raises(TypeError, match="simulate"):
        CaptureRefined(LABELLED, np.zeros((1, 1)), model=None)


@pytest.mark.parametrize("labels", [False, True])
def test_rounds_that_were_made_before_are_not_forgotten(labels):
    """One that takes up seven rounds and makes the eighth is as sure, and as near, as the one that made all."""

    def noise(number, measured, generator):
        return measured if labels else measured + 0.01 * generator.standard_normal(measured.shape)

    signature, simulate = (LABELLED, label) if labels else (toy_rounds.SIGNATURE, toy_rounds.simulate)
    made = {"rounds": 8, "noise": noise, "sd": 0.2}
    if labels:
        walk, _, first = identified(signature, simulate, lambda _, parameters: parameters, **made)
    else:
        walk, _, first = toy(**made)
    again = CaptureRefined(signature, walk.estimates[:, 6], model=first.model, simulate=simulate)
    again.recall(walk.rounds.first(7))
    last = walk.rounds.last(1)
    at = again.ask()[:, 0]
    again.tell(last.actions[:, 0], simulate(at, last.actions[:, 0])[0][:, None], last.measured[:, 0])
    np.testing.assert_allclose(again.sd, walk.sd[:, -1], rtol=0.3)
    off = np.abs(again.best - walk.estimates[:, -1])
    assert (off < 0.5 * walk.sd[:, -1] + 1e-9).all()
