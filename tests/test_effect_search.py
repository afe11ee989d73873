"""Which of the accepted effects stay, where something is left."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from balances import Made
from case_logs import log_of
from held_inputs import held_machine
from machines import machine

from benchmarks._planted_logs.cases import PLANTED, Case
from capture_cli.estimate.balance.balanced_model import BalancedModel
from capture_cli.estimate.fit import SETTINGS as FIT
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.model_fits import Effort, ModelFits
from capture_cli.estimate.part_fit import PartFit
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.solve.linearization import SETTINGS as LINEARIZATION
from capture_cli.estimate.solve.linearization import Data, Linearization
from capture_cli.estimate.split import NewSplit
from capture_cli.log.input_sequences import HELD
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.finer_time_step import FinerTimeStep
from capture_cli.model.effects.placed import Placed
from capture_cli.select.candidates import Candidate, all_candidates
from capture_cli.select.log_parts import Folds, LogParts
from capture_cli.select.model_comparison import ModelComparison
from capture_cli.select.reason import Reason, Rejection
from capture_cli.select.score import Score
from capture_cli.select.search import attribution as attribution_module
from capture_cli.select.search import balance_round, rivals
from capture_cli.select.search.answer import Accepted
from capture_cli.select.search.attribution import Attribution
from capture_cli.select.search.balance_round import _ended, _ends
from capture_cli.select.search.extension import NOT_ASKED, Extension
from capture_cli.select.search.forward_round import _settles
from capture_cli.select.search.removal import backward, without_minor
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.diagnose import diagnose
from capture_cli.stages.record import record

SAMPLES = 8868
# of the slider, by their place and how many parameters they have
EFFECTS = {
    ("force", 0): "finer-time-step@half",
    ("force", 1): "constant-force@x",
    ("force", 2): "hysteretic-friction@x",
    ("model", 1): "coulomb-friction@x",
    ("model", 2): "preloaded-spring@x",
}


LIKE_A_BIAS = (
    *("spring-preload@mcp", "sensor-bias@mcp", "sensor-eccentricity@mcp", "reflected-inertia@pip"),
    *("payload@distal", "cogging@pip", "control-second-order-lag", "sensor-second-order-low-pass@pip"),
    *("sensor-delay@pip", "sensor-low-pass@pip"),
)


@cache
def slider() -> Made:
    """A short log of the slider."""
    return Made.of("slider", episodes=1)


def of_slider(name: str) -> Placed:
    return next(p for p in slider().placed if p.name == name)


@pytest.fixture
def folds() -> Folds:
    """All is fitted, and nothing judges."""
    every = np.ones(len(slider().prepared.windows), dtype=bool)
    return Folds(every, (), every)


@pytest.fixture
def models(folds) -> ModelComparison:
    return ModelComparison(ModelFits(slider().prepared, 1), folds, seed=0)


@pytest.fixture
def attribution(folds):
    """attribution(effects): a search among these."""

    def made(effects: Sequence[Placed]) -> Attribution:
        candidates = [Candidate(p) for p in effects]
        return Attribution(ModelFits(slider().prepared, 1), folds, seed=0, candidates=candidates)

    return made


def fit_leaving(squares: float, *effects: Placed, samples: int = SAMPLES) -> Fit:
    """A fit of the slider with `effects` that leaves so much, in independent samples."""
    space = Simulator(slider().prepared.task, effects, threads=1).space
    shape, none = (1, samples, 1), np.zeros((1, samples, 0))
    data = Data(space, np.zeros(shape), np.ones(shape, dtype=bool), np.ones(1), np.zeros((1, 0)))
    x = np.full(len(space), 0.5)
    # each of another sign than the one before: there is no correlation
    residual = np.sqrt(squares / samples) * (-1.0) ** np.arange(samples)[None]
    slopes = np.random.default_rng(0).standard_normal((1, samples, len(space)))
    at = Linearization(data, x, np.zeros((1, 0)), residual, slopes, none)
    return Fit(effects, space, space.from_unit(x), at)


def part_leaving(residual: np.ndarray) -> PartFit:
    """What judges, where a model leaves this residual (window, step)."""
    space, shape, windows = slider().prepared.task.space, (*residual.shape, 1), len(residual)
    data = Data(space, np.zeros(shape), np.ones(shape, dtype=bool), np.ones(1), np.zeros((windows, 2)))
    return PartFit(data, np.zeros((windows, 2)), residual, *np.zeros((2, windows)))


def judged_by_blocks(
    parameters: int, squares: float, blocks: np.ndarray, place: str = "force", samples: int = SAMPLES
) -> Candidate:
    """A candidate that leaves `squares` where it was fitted, and `blocks` (block,) where it is judged."""
    placed = of_slider(EFFECTS[place, parameters])
    # a window for each block, of two steps
    residual = np.sqrt(blocks / 2)[:, None] * [1.0, -1.0]
    fit = fit_leaving(squares, placed, samples=samples)
    return Candidate(placed, score_with(np.eye(3)[parameters]), fit=fit, select=part_leaving(residual))


def score_with(response: np.ndarray, gain: float = 100.0) -> Score:
    none = np.zeros(0)
    return Score(gain, none, none, 1.0, response)


def judged_by_residual(residual: np.ndarray) -> Candidate:
    """A candidate without parameters that leaves this residual (window, step) where it is judged."""
    placed = of_slider(EFFECTS["force", 0])
    return Candidate(placed, fit=fit_leaving(1.0, placed, samples=1400), select=part_leaving(residual))


@pytest.mark.parametrize("seed", range(20))
def test_what_is_better_everywhere_is_behind_nothing(models, seed):
    """By 5 % of the sd: of blocks of two samples the mean logarithm is 0.2 below that of three, which is 10 %."""
    noise = np.random.default_rng(seed).standard_normal((12, 125))
    worse = judged_by_residual(noise)
    better = judged_by_residual(0.95 * (noise + 0.02 * np.roll(noise, 1, axis=1)))
    assert models._behind(better, worse) > 100 and models._behind(worse, better) < -100
    assert not models._indistinct(better, worse) and not models._indistinct(worse, better)
    assert np.argmin(models.losses([worse, better])) == 1


@pytest.mark.parametrize(("less", "said"), [(2e-4, Reason.TIED), (2e-2, Reason.EXPLAINS_LESS)])
def test_a_difference_that_is_steady_and_next_to_nothing_makes_no_winner(models, less, said):
    """Of an inertia on a joint and a centre of mass that is farther out, with one parameter more, both open masses."""
    blocks = 10 + np.random.default_rng(0).normal(0, 0.5, 60)
    mine, other = judged_by_blocks(2, 8140.2, (1 - less) * blocks), judged_by_blocks(1, 8140.2, blocks)
    assert models.compare(mine, other) == said
    assert models.as_good(mine, other) is (said == Reason.TIED)


@pytest.mark.parametrize(
    ("judged", "said"), [(-17.0, Reason.TIED), (-60.0, None), (17.0, Reason.EXPLAINS_LESS)]
)
def test_windows_that_contradict_each_other_make_no_winner(models, judged, said):
    """A bias of a set point and one of a sensor: the fitted windows are for one by 17 of twice the log likelihood."""
    blocks = 10 + np.random.default_rng(0).normal(0, 0.5, 60)
    mine = judged_by_blocks(1, 8140.0, blocks)
    other = judged_by_blocks(1, 8140.0 * np.exp(17 / SAMPLES), blocks * np.exp(judged / SAMPLES))
    other.score = score_with(np.eye(3)[0])
    assert models.compare(mine, other) == said


@pytest.mark.parametrize(("less", "as_good"), [(6e-4, True), (5e-3, False)])
def test_parameters_that_gain_nothing_are_not_taken_for_a_steady_trifle(models, less, as_good):
    """A spring on one side, as stiff on the other, beside a spring: steadily better by 5 of twice the log likelihood,
    for 2 parameters that 8868 samples would have to gain 18 by.
    """
    blocks = 10 + np.random.default_rng(0).normal(0, 0.5, 60)
    one_sided, spring = judged_by_blocks(2, 8140.0, (1 - less) * blocks), judged_by_blocks(0, 8140.2, blocks)
    assert models.as_good(one_sided, spring) is as_good


@pytest.mark.parametrize(
    ("mine", "other", "behind", "is_first"),
    [
        (("force", 1), ("model", 1), 0.5, True),
        (("force", 1), ("model", 1), 3.0, False),
        (("force", 1), ("model", 2), 0.0, False),
        (("model", 1), ("model", 1), -0.5, False),
        (("model", 1), ("force", 1), -0.5, False),
        (("force", 1), ("force", 1), -0.5, False),
    ],
)
def test_of_two_that_do_as_well_the_one_that_mujoco_has_comes_first(models, mine, other, behind, is_first):
    """A drag in one direction, of a ball that only falls, and the drag that MuJoCo has; behind: of BIC."""
    blocks = 10 + np.random.default_rng(0).normal(0, 0.5, 60)
    found, rival = (
        judged_by_blocks(parameters, 1000.0 * np.exp(less / 1000.0), blocks, place, samples=1000)
        for (place, parameters), less in ((mine, 0.0), (other, behind))
    )
    best, others = models.best(found, [rival])
    assert best is (rival if is_first else found)
    assert others == [found if is_first else rival]


@pytest.mark.parametrize(
    ("judged", "said"), [(-9.0, Reason.TIED), (-1.0, Reason.MORE_PARAMETERS), (9.0, Reason.MORE_PARAMETERS)]
)
def test_more_parameters_that_predict_better_are_tied(models, judged, said):
    """A filter of second order beside a delay: the fit gains less than a parameter costs, what no fit saw gains 9."""
    blocks = 10 + np.random.default_rng(0).normal(0, 0.5, 60)
    noise = np.random.default_rng(1).normal(0, 0.02, 60)  # or every block would be better
    delay = judged_by_blocks(1, 8140.0, blocks)
    filtered = judged_by_blocks(2, 8140.0, blocks * np.exp(judged / SAMPLES + noise - noise.mean()))
    assert models.compare(delay, filtered) == said


@pytest.mark.parametrize(("gain", "said"), [(5.0, Reason.TIED), (-1.0, Reason.MORE_PARAMETERS), (20.0, None)])
def test_more_parameters_that_are_worth_their_price_are_tied(models, gain, said):
    """A centre of mass beside a sensor's bias, by 5 of BIC and no better on what judges: it is what is there."""
    blocks = 10 + np.random.default_rng(0).normal(0, 0.5, 60)
    price = np.log(SAMPLES)  # of a parameter
    bias = judged_by_blocks(1, 8140.0 * np.exp((gain + price) / SAMPLES), blocks)
    shift = judged_by_blocks(2, 8140.0, blocks)
    assert models.compare(bias, shift) == said


@pytest.mark.parametrize(("rough", "left", "kept"), [(True, 1.0, 0), (True, 6.0, 1), (False, 1.0, 1)])
def test_an_effect_is_dropped_that_led_out_of_a_poor_minimum(attribution, monkeypatch, rough, left, kept):
    """A puck off a wall: with its restitution the model left 1; from there without it, it leaves 1, or 6, of 12."""
    effect = of_slider(EFFECTS["force", 1])
    selection = attribution([effect])
    without, found, again = (
        fit_leaving(squares * SAMPLES, *effects)
        for effects, squares in (((), 12.0), ((effect,), 1.0), ((), left))
    )
    if rough:
        data = replace(found.at.data, initial_step=LINEARIZATION.rough_initial_step)
        found = replace(found, at=replace(found.at, data=data))
    selection.models.know(without)
    selection.answer.accepted = [Accepted(effect, None, [], None, 0.9)]
    monkeypatch.setattr(selection.models, "judge", lambda _: None)
    monkeypatch.setattr(selection.models, "better_from", lambda *_: again)
    assert backward(selection.answer, found) is (found if kept else again)
    assert len(selection.answer.accepted) == kept


@pytest.mark.parametrize(("together", "kept"), [(1.0, ["coulomb"]), (12.0, ["coulomb", "constant"])])
def test_effects_are_dropped_together_as_far_as_nothing_speaks_for_them_together(
    attribution, monkeypatch, together, kept
):
    """Of a bias and hysteresis each alone has nothing to do; of two that stand in for each other one has to stay."""
    needed, bias, hysteresis = (of_slider(EFFECTS[key]) for key in (("model", 1), ("force", 1), ("force", 2)))
    every = (needed, bias, hysteresis)
    selection = attribution(every)
    left = {
        every: 1.0,
        (needed, hysteresis): 1.0001,
        (needed, bias): 1.0002,
        (needed,): together,
        (bias, hysteresis): 12.0,
        (bias,): 12.0,
        (): 12.0,
    }
    fits = {effects: fit_leaving(squares * SAMPLES, *effects) for effects, squares in left.items()}
    for fit in fits.values():
        selection.models.know(fit)
    selection.answer.accepted = [Accepted(effect, None, [], None, 0.3) for effect in every]
    monkeypatch.setattr(selection.models, "judge", lambda _: None)
    last = backward(selection.answer, fits[every])
    assert [a.placed.kind.split("-")[0] for a in selection.answer.accepted] == kept
    assert [e.kind.split("-")[0] for e in last.effects] == kept


@pytest.mark.parametrize(
    ("shares", "error", "kept"),
    [
        ([0.9, 0.01, 0.02], 1.0, 3),  # nothing is left: that is what they were
        ([0.9, 0.01, 0.02], 1.15, 1),  # minor ones that leave something explain nothing
        ([0.9, 0.03], 1.15, 2),  # one alone that comes near the floor
        ([0.9, 0.03], 1.5, 1),
        ([0.9, 0.03, 0.06], 1.5, 3),  # what was minor led to one that is not
        ([0.7, 0.2], 20.0, 2),
        ([], 20.0, 0),
    ],
)
def test_minor_effects_stand_only_where_they_explain(attribution, shares, error, kept):
    effects = [of_slider(f"{kind}@x") for kind in ("coulomb-friction", "cubic-drag", "constant-force")]
    selection = attribution(effects[: len(shares)])
    for count in range(len(shares) + 1):
        fit = fit_leaving((error + 0.1 * (len(shares) - count)) ** 2 * SAMPLES, *effects[:count])
        selection.models.know(fit)
    pairs = zip(effects, shares, strict=False)
    selection.answer.accepted = [Accepted(p, None, [], None, share) for p, share in pairs]
    assert selection.models.is_explained(fit) == (error == 1.0)
    fit = without_minor(selection.answer, fit)
    assert fit.effects == tuple(a.placed for a in selection.answer.accepted) == tuple(effects[:kept])
    reasons = [c.rejection for c in selection.answer.candidates]
    assert reasons[:kept] == [None] * kept and all(r.reason == Reason.MINOR for r in reasons[kept:])


@pytest.mark.parametrize(("error", "enough"), [(1.01, True), (1.3, False)])
def test_a_rival_that_is_not_as_good_may_be_enough(attribution, monkeypatch, error, enough):
    """A delay and a lag on a model whose steps are too long: the better one is not the only one that explains."""
    lag, delay = (of_slider(f"control-{kind}@drive") for kind in ("lag", "delay"))
    selection = attribution([lag, delay])
    rival = Candidate(delay, score_with(np.ones(2)), start=np.full(1, 0.01))
    selection.answer.accepted = [Accepted(lag, score_with(np.ones(2)), [rival], None, 0.9)]
    current = fit_leaving(SAMPLES, lag)
    for fit in (current, fit_leaving(400 * SAMPLES), fit_leaving(error**2 * SAMPLES, delay)):
        selection.models.know(fit)
    assert selection.rivals.compare(current, selection.answer.accepted) is current
    rejection = selection.answer.candidates[1].rejection
    assert rejection.facts == {"best": "control-lag@drive"}
    assert rejection.reason == (Reason.EXPLAINS_ENOUGH if enough else Reason.EXPLAINS_LESS)
    # a third was better than the rival, and the effect better than that third: the rival may do better than the effect
    monkeypatch.setattr(selection.models, "best", lambda mine, others: (mine, others))
    monkeypatch.setattr(selection.models, "compare", lambda mine, other: None)
    selection.rivals.compare(current, selection.answer.accepted)
    assert selection.answer.candidates[1].rejection == Rejection(Reason.BEATEN, {"best": "control-lag@drive"})


@pytest.mark.parametrize(
    ("mine", "other", "alike", "asked"),
    [
        (19.0, 5400.0, 0.1, True),  # near null they see nothing of what the balance found
        (None, 5400.0, 0.1, True),
        (100.0, 85.0, 0.1, True),
        (100.0, 50.0, 0.1, False),
        (100.0, 50.0, 0.99, True),
    ],
)
def test_what_simulations_alone_tell_of_is_a_rival_of_what_the_balance_found(
    attribution, monkeypatch, mine, other, alike, asked
):
    """Friction that is harder than the model's, of a compliance."""
    spring, hard = of_slider("compliance@x"), of_slider("friction-hardness@x")
    gains = {spring.name: (mine, np.array([1.0, 0.0])), hard.name: (other, np.array([alike, 0.1]))}

    class FakeScores:
        def __init__(self, *_):
            pass

        def score(self, candidates):
            for candidate in candidates:
                gain, response = gains[candidate.name]
                candidate.score = None if gain is None else score_with(response, gain)
                candidate.rejection = Rejection(Reason.DIVERGED) if (gain or 0.0) < 20 else None

    monkeypatch.setattr(rivals, "Scores", FakeScores)
    selection = attribution([spring, hard])
    selection.answer.candidates[1].rejection = NOT_ASKED
    selection.answer.accepted = [Accepted(spring, None, [], None, 0.9)]
    selection.models.know(fit_leaving(400 * SAMPLES))
    selection.rivals._ask_simulations_for_rivals(fit_leaving(SAMPLES, spring), selection.answer.accepted[0])
    assert [r.name for r in selection.answer.accepted[0].rivals] == [hard.name] * asked
    expected = Reason.DOES_NOT_HOLD if asked else Reason.BEHIND_AT_FIRST_SIGHT
    assert selection.answer.candidates[1].rejection.reason == expected


def test_what_ended_at_a_limit_is_not_fitted_in_a_larger_set_that_has_it_there():
    hysteresis, coulomb = (
        Placed(name, REGISTRY.get(name)(machine("slider"), "x"))
        for name in ("hysteretic-friction", "coulomb-friction")
    )
    space = hysteresis.effect.space
    at_end, inside = space.from_unit(np.array([[0.1, 0.0], [0.1, 0.2]]))
    at_ends = [(frozenset({hysteresis.name}), _ends([hysteresis], [at_end]), "at its end")]

    def said(values, *others, beyond_noise=10.0):
        effects = (hysteresis, *others)
        model = BalancedModel(
            effects,
            np.zeros(1),
            (values, *(e.effect.space.from_unit(np.array([0.1])) for e in others)),
            beyond_noise=beyond_noise,
        )
        return _ended(model, 0, at_ends)

    assert said(at_end, coulomb) == "at its end"
    assert said(inside, coulomb) is None
    assert said(at_end) is None  # the same set, not a larger one
    assert said(at_end, coulomb, beyond_noise=0.5) is None  # with both nothing may be left


def test_no_shorter_steps_are_fitted_where_half_a_step_does_not_hold():
    model = machine("slider")
    half, quarter, eighth = (
        Candidate(Placed("finer-time-step", FinerTimeStep(model, site)))
        for site in ("half", "quarter", "eighth")
    )
    assert not _settles(half, quarter, ())  # it was not fitted yet
    half.rejection = Rejection(Reason.NO_GAIN)
    assert _settles(half, quarter, ()) and _settles(half, eighth, ())
    assert not _settles(quarter, half, ())
    assert not _settles(half, eighth, (half.name,))  # it takes something, if not enough


def test_a_model_has_one_step(attribution):
    model, friction = slider().prepared.task.model, of_slider("coulomb-friction@x")
    steps = [Placed("finer-time-step", FinerTimeStep(model, site)) for site in ("half", "quarter")]
    answer = attribution([*steps, friction]).answer
    assert [c.name for c in answer.beside({friction.name})] == [s.name for s in steps]
    assert [c.name for c in answer.beside({steps[0].name})] == [friction.name]


def test_rivals_are_compared_by_what_they_answered_in_one_round(tmp_path, monkeypatch, without_pages):
    """Later, with the accepted effect in the model, a rival answers to what that one leaves."""
    rounds, compared, begun = {}, [], []
    score, balance_round_of, compare = (
        balance_round.score_in_balance,
        Extension._balance_round,
        ModelComparison.compare,
    )

    def tagged(screening, current, candidates, *polished):
        score(screening, current, candidates, *polished)
        number = len(rounds)
        for candidate in candidates:
            # kept: an id is of one that lives
            rounds[id(candidate.score)] = number, candidate.score

    def begin(self, current):
        begun.append(current)
        return balance_round_of(self, current)

    def judged(self, mine, other):
        compared.append([rounds[id(c.score)][0] for c in (mine, other)])
        return compare(self, mine, other)

    few = ("control-delay", "sensor-delay", "control-lag", "coulomb-friction")
    catalogue = attribution_module.all_candidates
    monkeypatch.setattr(
        attribution_module, "all_candidates", lambda log: [c for c in catalogue(log) if c.placed.kind in few]
    )
    monkeypatch.setattr(balance_round, "score_in_balance", tagged)
    monkeypatch.setattr(rivals, "score_in_balance", tagged)
    monkeypatch.setattr(Extension, "_balance_round", begin)
    monkeypatch.setattr(ModelComparison, "compare", judged)
    effects = ["control-delay@drive=0.006", "coulomb-friction@x=0.1"]
    log, task = tmp_path / "log.zarr", str(held_machine(tmp_path / "slider", "slider", 0.005))
    record(task=task, out=log, effects=effects, noise=1e-4, duration=3, rate=100)
    diagnose(real_log=log, task=task, out=tmp_path / "diagnosis", expression=False, quiet=True)
    assert begun and compared
    assert all(mine == other for mine, other in compared)


def test_an_effect_of_all_sensors_is_tried_at_each_that_is_in_the_log(
    slider_task, tmp_path, monkeypatch, without_pages
):
    model = slider_task.parent / "model.xml"
    more = '<jointvel name="v" joint="x"/><actuatorfrc name="not logged" actuator="drive"/></sensor>'
    model.write_text(model.read_text().replace("</sensor>", more))
    outputs = '[outputs.q]\ncolumn = "q_m"\nunit = "m"\n'
    slider_task.write_text(
        slider_task.read_text().replace(outputs, outputs + '[outputs.v]\ncolumn = "v"\nunit = "m/s"\n')
    )
    catalogue = attribution_module.all_candidates
    monkeypatch.setattr(
        attribution_module,
        "all_candidates",
        lambda log: [c for c in catalogue(log) if c.placed.kind == "sensor-delay"],
    )
    log, task, out = tmp_path / "log.zarr", str(slider_task), tmp_path / "diagnosis"
    effects = ["sensor-delay@q=0.012", "sensor-delay@v=0.02"]
    record(task=task, out=log, effects=effects, noise=1e-4, duration=3, rate=100, amplitude={"drive": 8.0})
    diagnose(real_log=log, task=task, out=out, quiet=True)
    found = json.loads((out / "diagnosis.json").read_text())["effects"]
    delays = {e["site"]: e["parameters"]["delay"]["value"] for e in found}
    assert delays == pytest.approx({"q": 0.012, "v": 0.02}, abs=1e-3)


@pytest.mark.parametrize(
    "effects",
    [
        ["coulomb-friction@shoulder=0.15", "coulomb-friction@elbow=0.1"],
        ["coulomb-friction@shoulder=0.15", "sensor-delay@q2=0.006"],
    ],
)
def test_what_is_missing_at_every_joint_is_found_at_once(tmp_path, monkeypatch, without_pages, effects):
    """A law at both joints, and two effects of two kinds, of which the first is not spread to other places."""
    catalogue, balance_round_of, begun = attribution_module.all_candidates, Extension._balance_round, []
    few = ("coulomb-friction", "sensor-delay", "viscous-damping")
    monkeypatch.setattr(
        attribution_module, "all_candidates", lambda log: [c for c in catalogue(log) if c.placed.kind in few]
    )
    monkeypatch.setattr(
        Extension, "_balance_round", lambda self, fit: begun.append(fit) or balance_round_of(self, fit)
    )
    log, task = tmp_path / "log.zarr", str(held_machine(tmp_path / "arm", "arm", 0.002))
    record(task=task, out=log, effects=effects, noise=1e-4, episodes=4, duration=2, rate=100, threads=1)
    found = diagnose(real_log=log, task=task, out=tmp_path / "d", quiet=True, most_effects=2).document
    assert {f"{e['name']}@{e['site']}" for e in found["effects"]} == {e.split("=")[0] for e in effects}
    assert found["verdict"] == "effect-found" and len(begun) == 1


def test_a_law_that_simulations_alone_tell_of_is_found_at_every_joint_in_one_round(
    tmp_path, monkeypatch, without_pages
):
    """Friction that holds harder than MuJoCo's shows where joints rest: the balance has no rows of that."""
    catalogue, few = attribution_module.all_candidates, ("friction-hardness", "coulomb-friction")
    monkeypatch.setattr(
        attribution_module, "all_candidates", lambda log: [c for c in catalogue(log) if c.placed.kind in few]
    )
    log, task = tmp_path / "log.zarr", held_machine(tmp_path / "arm", "arm", 0.002)
    model = task.with_name("model.xml")
    model.write_text(model.read_text().replace("damping=", 'frictionloss=".2" damping='))
    effects = ["friction-hardness@shoulder=1.5", "friction-hardness@elbow=1.5"]
    record(task=str(task), out=log, effects=effects, noise=1e-4, episodes=4, duration=2, rate=100, threads=1)
    found = diagnose(real_log=log, task=str(task), out=tmp_path / "d", quiet=True, most_effects=1).document
    assert {f"{e['name']}@{e['site']}" for e in found["effects"]} == {e.split("=")[0] for e in effects}


def test_what_parameters_stand_in_for_is_found_where_they_leave_nothing(tmp_path, monkeypatch, without_pages):
    catalogue, few = attribution_module.all_candidates, ("quadratic-drag", "coulomb-friction", "sensor-delay")
    monkeypatch.setattr(
        attribution_module, "all_candidates", lambda log: [c for c in catalogue(log) if c.placed.kind in few]
    )
    log, task = tmp_path / "log.zarr", str(held_machine(tmp_path / "slider", "slider", 0.002))
    drag = ["quadratic-drag@x=0.3"]
    record(task=task, out=log, effects=drag, noise=1e-3, episodes=4, duration=4, rate=100, threads=1)
    found = diagnose(real_log=log, task=task, out=tmp_path / "d", quiet=True).document
    assert not found["lack_of_fit"]["before"]["lacking"]
    assert found["verdict"] == "effect-found"
    assert [e["name"] for e in found["effects"]] == ["quadratic-drag"]


def test_a_simpler_effect_is_asked_where_the_balance_prefers_one_with_more_parameters(
    tmp_path, monkeypatch, without_pages
):
    """A filter as slow as this is beyond first order, and a compliance, which has four parameters, bends as it does."""
    catalogue, few = attribution_module.all_candidates, ("compliance", "sensor-low-pass")
    monkeypatch.setattr(
        attribution_module, "all_candidates", lambda log: [c for c in catalogue(log) if c.placed.kind in few]
    )
    log, task = tmp_path / "log.zarr", str(held_machine(tmp_path / "slider", "slider", 0.005))
    effects = ["sensor-low-pass@q=0.045"]
    record(task=task, out=log, effects=effects, noise=5e-4, episodes=4, duration=3, rate=100, threads=1)
    [found] = diagnose(real_log=log, task=task, out=tmp_path / "d", quiet=True).document["effects"]
    assert "sensor-low-pass" in [found["name"], *(name.split("@")[0] for name in found["tied_with"])]


def test_rivals_of_a_rival_that_takes_the_place_of_an_effect_are_asked():
    """At 50 Hz the balance of a light finger puts first what no simulation can do, and an eccentric sensor before its
    bias, which takes its place; the spring that rests elsewhere is a rival of that one.
    """
    case = Case(PLANTED, "finger", ("spring-preload@mcp",), 2.2, 1951297624, dress="slow")
    task, log = log_of(case, 0.0061859)
    task.inputs = tuple(replace(c, hold=HELD) for c in task.inputs)
    prepared = prepare(log, task, split=NewSplit(seed=case.number), threads=1)
    few = [c for c in all_candidates(prepared) if c.name in LIKE_A_BIAS]
    parts, fits = LogParts.of(prepared), ModelFits(prepared, 1, from_balance=True)
    declared = fits.fit(parts.fitted, [], task.space.nominal, effort=Effort(tolerance=FIT.exact))
    attribution = Attribution(fits, parts.folds, seed=0, candidates=few)
    attribution.run(declared)
    (found,) = attribution.answer.accepted
    assert "spring-preload@mcp" in [found.name, *found.tied_with]


@pytest.mark.parametrize(("dress", "contradicts"), [("plain", False), ("slow", True)])
def test_simulations_contradict_the_balance_between_commands_that_are_held_for_long(dress, contradicts):
    """20 ms, in which a servo that swings in 0.2 s moves as its rows do not show."""
    case = Case(PLANTED, "pan_tilt", ("control-bias@pan",), 2.2, 1725943794, dress=dress)
    task, log = log_of(case, 0.0081)
    task.inputs = tuple(replace(c, hold=HELD) for c in task.inputs)
    prepared = prepare(log, task, threads=1)
    few = [c for c in all_candidates(prepared) if c.placed.kind == "control-bias"]
    bias = next(c.placed for c in few if c.name == "control-bias@pan")
    parts, fits = LogParts.of(prepared), ModelFits(prepared, 1)
    start = np.append(task.space.nominal, 0.003)
    found = fits.fit(parts.fitted, [bias], start, effort=Effort(tolerance=FIT.exact))
    attribution = Attribution(fits, parts.folds, seed=0, candidates=few)
    assert attribution.models.is_explained(found)
    assert attribution.rivals._contradicts_balance(found) is contradicts


LATE = (
    "control-delay",
    "control-lag",
    "control-second-order-lag",
    "control-gain",
    "sensor-low-pass",
    "sensor-delay",
)


@pytest.mark.parametrize(
    ("effect", "found"),
    [
        ("control-delay@drive=0.16", {"control-delay@drive"}),
        ("control-lag@drive=0.3", {"control-lag@drive"}),
        # what it moves is linear: late commands do the same
        ("sensor-delay@q=0.16", {"control-delay@drive", "sensor-delay@q"}),
    ],
)
def test_what_is_far_too_late_is_found(effect, found, tmp_path, monkeypatch, without_pages):
    """Fits from a small delay do not get there: a sixth of a second is several turns of what drives the machine."""
    catalogue = attribution_module.all_candidates
    monkeypatch.setattr(
        attribution_module, "all_candidates", lambda log: [c for c in catalogue(log) if c.placed.kind in LATE]
    )
    log, task = tmp_path / "log.zarr", str(held_machine(tmp_path / "slider", "slider", 0.005))
    record(task=task, out=log, effects=[effect], noise=1e-3, episodes=3, duration=4, rate=100)
    told = diagnose(real_log=log, task=task, out=tmp_path / "diagnosis", expression=False, quiet=True)
    [one] = told.document["effects"]
    assert found <= {f"{one['name']}@{one['site']}", *one["tied_with"]}


def test_a_rival_at_the_other_end_has_no_score(models):
    """It is fitted for its law, and may have more parameters."""
    blocks = np.full(40, 2.0)
    mine, other = judged_by_blocks(1, 8140.0, blocks), judged_by_blocks(2, 8139.0, blocks)
    assert models.compare(mine, replace(other, score=None)) == Reason.MORE_PARAMETERS


@pytest.mark.parametrize(("left", "useful"), [(900.0, 9.5), (0.5, 1.2)])
def test_what_takes_most_of_what_is_left_is_not_minor(models, left, useful):
    """However much an effect before it took: of a quiet sensor's log that is most of a million squared floors."""
    models.excess = 1e6
    current = fit_leaving((1 + left) * SAMPLES)
    assert models.useful_error(current) == pytest.approx(useful, rel=0.02)


def test_what_is_left_of_a_log_without_noise_is_rounding(attribution, monkeypatch):
    """Anything is significant in that, so no effect is asked."""
    monkeypatch.setattr(ModelComparison, "screening_about", lambda *_, **__: pytest.fail("asked"))
    search = attribution([of_slider("coulomb-friction@x")])
    assert not search.extension.is_missing(fit_leaving(1e-5 * SAMPLES))
