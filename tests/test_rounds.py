"""Identification in rounds: the contract that every identifier keeps, the loop, and what a round is made of."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from setting_numbers import set_numbers
from toy_rounds import SIGNATURE, draw_actions, histories, simulate, trajectories

from capture_cli.common.extras import missing
from capture_cli.context.identifiers import REGISTRY, log_identifier, round_identifier
from capture_cli.context.identifiers.base import Rounds, Signature, run_rounds
from capture_cli.context.identifiers.compass import Compass
from capture_cli.context.identifiers.domain_randomization import DomainRandomization
from capture_cli.errors import OptionError
from capture_cli.estimate.solve.base import Identifier
from capture_cli.estimate.solve.cma_es import CmaEs

PLAIN = [
    pytest.param(
        n, marks=pytest.mark.skipif(bool(c.extra and missing(c.extra)), reason=f"needs the extra {c.extra}")
    )
    for n, c in REGISTRY.items()
    if not c.needs_checkpoint
]
PAIRS, ROUNDS = 6, 4
# mean error after four rounds, over the range; who does not look is at 1/3
WITHIN = {"domain-randomization": 1.0, "compass": 0.1, "least-squares": 1e-4, "cma-es": 0.01}


class Counting:
    """The toy's simulator, with a count."""

    def __init__(self):
        self.rollouts = 0

    def __call__(self, parameters, actions):
        assert (parameters >= SIGNATURE.space.low).all() and (parameters <= SIGNATURE.space.high).all()
        self.rollouts += len(actions)
        return simulate(parameters, actions)


def walk(name: str, pairs: slice = slice(None), seed: int = 1, **options):
    """A walk of some of six pairs, their targets, and the simulator."""
    generator = np.random.default_rng(3)
    target, start = (SIGNATURE.space.from_unit(generator.random((PAIRS, 2)))[pairs] for _ in range(2))
    actions = [draw_actions(generator, PAIRS)[pairs] for _ in range(ROUNDS)]
    simulator = Counting()
    identifier = round_identifier(name)(SIGNATURE, start, simulate=simulator, seed=seed, **options)
    done = run_rounds(
        identifier,
        ROUNDS,
        act=lambda number, _: actions[number],
        simulate=simulator,
        measure=lambda _, a: trajectories(target, a),
    )
    return done, target, simulator


@pytest.fixture(scope="module")
def walked():
    return cache(walk)


@pytest.mark.parametrize("name", PLAIN)
def test_it_comes_near_a_planted_target(walked, name):
    done, target, _ = walked(name)
    error = np.abs(done.estimates[:, -1] - target) / SIGNATURE.space.span
    assert error.mean() < WITHIN[name]


@pytest.mark.parametrize("name", PLAIN)
def test_every_simulation_is_counted(walked, name):
    done, _, simulator = walked(name)
    assert done.simulated_rollouts[:, -1].sum() == simulator.rollouts
    assert (np.diff(done.simulated_rollouts, axis=1) > 0).all()


@pytest.mark.parametrize("name", PLAIN)
def test_the_same_seed_gives_the_same_walk(walked, name):
    again, _, _ = walk(name)
    assert np.array_equal(again.estimates, walked(name)[0].estimates)


@pytest.mark.smoke
@pytest.mark.parametrize("name", PLAIN)
def test_asking_twice_asks_the_same(name):
    start = SIGNATURE.space.from_unit(np.full((2, 2), 0.3))
    identifier = round_identifier(name)(SIGNATURE, start, simulate=simulate)
    assert np.array_equal(identifier.best, start)
    asked = identifier.ask()
    assert asked.shape == (2, identifier.candidates, 2)
    assert np.allclose(asked[:, 0], start, rtol=1e-12)
    assert np.array_equal(identifier.ask(), asked)


@pytest.mark.parametrize("name", ["least-squares", "cma-es"])
def test_pairs_know_nothing_of_each_other(walked, name):
    alone, _, _ = walk(name, slice(0, 1))
    assert np.array_equal(alone.estimates[0], walked(name)[0].estimates[0])


def test_only_ten_rounds_are_refitted():
    simulator = Counting()
    start = SIGNATURE.space.from_unit(np.full((1, 2), 0.3))
    target = SIGNATURE.space.from_unit(np.full((1, 2), 0.7))
    generator = np.random.default_rng(0)
    identifier = round_identifier("least-squares")(SIGNATURE, start, simulate=simulator)
    run_rounds(
        identifier,
        14,
        act=lambda *_: draw_actions(generator, 1),
        simulate=simulator,
        measure=lambda _, a: trajectories(target, a),
    )
    before = identifier.simulated_rollouts[0]
    action = draw_actions(generator, 1)
    identifier.tell(action, simulate(identifier.best, action)[0][:, None], trajectories(target, action))
    assert (identifier.simulated_rollouts[0] - before) % 10 == 0


def test_domain_randomization_takes_others_every_round():
    assert not np.allclose(*walk("domain-randomization")[0].estimates[0, :2])


def test_what_diverged_is_told_as_zeros():
    told = []

    class Listening(DomainRandomization):
        def tell(self, actions, simulated, measured):
            told.append(simulated)

    run_rounds(
        Listening(SIGNATURE, SIGNATURE.space.nominal[None]),
        1,
        act=lambda *_: SIGNATURE.actions.nominal[None],
        simulate=lambda p, a: (np.full((1, 6, 2), np.nan), np.array([True])),
        measure=lambda _, a: np.ones((1, 6, 2)),
    )
    assert not told[0].any()


def test_an_identifier_of_logs_needs_a_simulator_in_rounds():
    with pytest.raises(ValueError, match="give it `simulate`"):
        round_identifier("least-squares")(SIGNATURE, SIGNATURE.space.nominal[None])


def test_cma_es_keeps_its_state_over_rounds(monkeypatch):
    """Two rounds of few generations: a search that begins anew in the second forgets what the first was for."""
    set_numbers(monkeypatch, "capture_cli.context.identifiers.refitted", effort=6)
    kept, target, simulator = walk("cma-es")
    monkeypatch.setattr(CmaEs, "carried_on", lambda *_: None)
    begun, _, spent = walk("cma-es")
    errors = [np.abs(done.estimates - target[:, None]).mean(axis=(0, 2)) for done in (kept, begun)]
    assert np.array_equal(errors[0][0], errors[1][0])
    assert errors[0][-1] < 0.5 * errors[1][-1]
    assert simulator.rollouts == spent.rollouts


@pytest.mark.smoke
def test_identifiers_by_name():
    assert {"capture", "expert-distillation", "tunenet", "posterior", "compass"} <= set(REGISTRY.names())
    assert "intervals" not in REGISTRY.names()
    assert issubclass(log_identifier("least-squares"), Identifier)
    with pytest.raises(OptionError, match="works in rounds"):
        log_identifier("compass")
    with pytest.raises(OptionError, match="unknown identifier"):
        round_identifier("compas")
    assert all(c.summary for _, c in REGISTRY.items())


# --- what a round is made of ---


def test_a_signature_survives_json():
    again = Signature.from_document(json.loads(json.dumps(SIGNATURE.document())))
    assert again.differences(SIGNATURE) == [] and again.document() == SIGNATURE.document()


def test_rounds_are_cut_and_joined():
    rounds = histories(4, rounds=5)
    assert rounds.first(2).rounds == 2 and rounds.last(9).rounds == 5
    begun = Rounds.none(4, SIGNATURE)
    for i in range(5):
        begun = begun.then(
            *(getattr(rounds, n)[:, i] for n in ("parameters", "actions", "simulated", "measured"))
        )
    assert np.array_equal(begun.measured, rounds.measured) and np.array_equal(begun.actions, rounds.actions)
    assert np.array_equal(begun.last(2).simulated, rounds.simulated[:, 3:])
    assert np.array_equal(rounds.pairs(slice(1, 3)).target, rounds.target[1:3])


@pytest.mark.usefixtures("learn")
def test_compass_computes_on_one_thread_and_leaves_the_number_as_it_was(monkeypatch):
    import torch

    used, descend = [], Compass._descend

    def seen(self):
        used.append(torch.get_num_threads())
        return descend(self)

    monkeypatch.setattr(Compass, "_descend", seen)
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        compass = Compass(SIGNATURE, SIGNATURE.space.nominal[None], seed=0)
        actions = draw_actions(np.random.default_rng(0), 1)
        asked = compass.ask()
        simulated = trajectories(asked[0], np.repeat(actions, asked.shape[1], axis=0))[None]
        compass.tell(actions, simulated, trajectories(SIGNATURE.space.low[None], actions))
        assert (used, torch.get_num_threads()) == ([1], 2)
    finally:
        torch.set_num_threads(before)
