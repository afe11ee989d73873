"""Effects that repeat along time or position: every frequency is judged, and the best are simulated."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from machines import machine

from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.noise.lack_of_fit import lack_of_fit
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.split import NewSplit
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects._periodic_force import PeriodicForce
from capture_cli.model.effects.placed import Placed
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks import load_task
from capture_cli.select.candidates import Candidate
from capture_cli.select.log_parts import select_folds
from capture_cli.select.narrow_peaks import NarrowPeaks, _peaks
from capture_cli.select.pulses import SETTINGS as PULSES
from capture_cli.select.pulses import PulseResponse, Pulses
from capture_cli.select.score import score
from capture_cli.select.search import attribution as attribution_module
from capture_cli.select.search import extension
from capture_cli.select.search.attribution import Attribution
from capture_cli.simulate.engine import Engine
from capture_cli.stages.record import record

SLIDER = Path(__file__).parents[1] / "benchmarks" / "machines" / "slider" / "task.toml"
PERIODIC = [name for name, effect in REGISTRY.items() if issubclass(effect, PeriodicForce)]


def on_slider(name: str, model=None) -> PeriodicForce:
    """The effect at the one place that it has on a slider, that of the tests where None."""
    model = model or machine("slider")
    (site,) = REGISTRY.get(name).sites(model)
    return REGISTRY.get(name)(model, site)


@pytest.mark.parametrize("name", PERIODIC)
@pytest.mark.parametrize("span", [0.7, 30.0])
def test_a_sweep_leaves_no_room_for_a_peak_between_two_shapes(name, span):
    effect = on_slider(name)
    points = effect.sweep(span, 40_000)
    column = effect.space.names.index(effect.shapes[0])
    frequencies = np.sort(effect.frequency(points[:, column]))
    assert np.diff(frequencies).max() <= 0.5 / span * (1 + 1e-9)
    ends = effect.frequency(np.array([effect.space.low[column], effect.space.high[column]]))
    np.testing.assert_allclose(frequencies[[0, -1]], np.sort(ends))
    assert not np.delete(points, column, axis=1).any()
    assert len(effect.sweep(span, 7)) == 7


@pytest.mark.parametrize("count", [2, 5, 5000])
@pytest.mark.parametrize("name", PERIODIC)
def test_the_waves_along_a_path_are_what_the_kernel_gives(name, count):
    effect = on_slider(name)
    path = np.linspace(-0.2, 0.3, 12).reshape(3, 4)
    points = effect.sweep(20.0, count)
    waves = effect.waves(points, path)
    assert waves.shape == (len(points), 2, 3, 4)
    for point, wave in zip(points, waves, strict=True):
        shape = {effect.shapes[0]: point[effect.space.names.index(effect.shapes[0])]}
        np.testing.assert_allclose(
            2 * wave[0] - 3 * wave[1], effect.kernel(path, sine=2, cosine=-3, **shape), atol=1e-9
        )


def test_pulses_add_up_to_a_force_whatever_the_chunks(monkeypatch):
    """On a linear machine the responses to pulses add up to that to their sum."""
    model = machine("slider")
    pulses = Pulses.over(model, "x", 150, 0.1)
    assert pulses.count < PULSES.most and pulses.fastest > 10
    heights = np.random.default_rng(0).uniform(-1, 1, pulses.count)
    every = np.vstack([np.zeros(pulses.count), np.diag(heights), heights])
    monkeypatch.setattr("capture_cli.simulate.engine.CHUNK_SIMULATIONS", 5)
    count = len(every)
    still = InitialStates(*(np.zeros((count, n)) for n in (model.nq, model.nv, model.na)), np.zeros(count))
    sensors = (
        Engine(model, 1)
        .rollout(
            initial=still,
            controls=np.zeros((count, 150, model.nu)),
            forces=[pulses.force(every, model.opt.timestep)],
        )
        .sensors
    )
    responses = sensors[1:] - sensors[0]
    assert np.abs(responses[-1]).max() > 1e-5
    np.testing.assert_allclose(responses[:-1].sum(axis=0), responses[-1], atol=1e-12)


def test_pulses_follow_a_force_that_they_are_fast_enough_for():
    pulses = Pulses.over(machine("slider"), "x", 250, 0.05)
    steps = np.arange(250)
    wave = np.sin(2 * np.pi * 20 * steps * 0.002)
    shares = pulses.shares(steps)
    assert np.abs(shares.sum(axis=1) - 1).max() < 1e-12
    followed = shares @ np.linalg.pinv(shares) @ wave
    assert wave @ followed / (wave @ wave) > 0.9
    long = Pulses.over(machine("slider"), "x", 5000, 0.05)
    assert long.count <= PULSES.most and long.fastest < 5


def test_the_best_peaks_are_local_maxima():
    gains = np.array([1.0, 5.0, 4.0, 9.0, 8.0, 8.5, 0.0, 7.0])
    assert _peaks(gains, 3).tolist() == [3, 5, 7]


def test_pulses_that_move_nothing_promise_nothing():
    response = PulseResponse(
        gram=np.zeros((2, 3, 3)),
        across=np.zeros((2, 3, 1)),
        pull=np.zeros((2, 3)),
        hessian=np.ones((1, 1)),
        gradient=np.ones(1),
    )
    gains = response.gains(np.random.default_rng(0).standard_normal((4, 2, 2, 3)))
    assert not gains.any()
    assert len(_peaks(gains, 3)) == 1


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Of the slider, prepared: with a force that repeats in time, in space, with a motor's that does, and with none."""
    folder = tmp_path_factory.mktemp("logs")
    made = {}
    for name, effects in (
        ("time", ["periodic-disturbance@x.sine=1.5", "periodic-disturbance@x.frequency=2.29"]),
        ("slow", ["periodic-disturbance@x.sine=1.5", "periodic-disturbance@x.frequency=0.7"]),
        ("space", ["cogging@x.cosine=1.2", "cogging@x.period=0.097"]),
        ("motor", ["torque-ripple@drive.cosine=0.2", "torque-ripple@drive.period=0.097"]),
        ("none", []),
    ):
        log = record(
            task=str(SLIDER),
            out=folder / f"{name}.zarr",
            effects=effects,
            noise=5e-4,
            episodes=4,
            duration=2.0,
            rate=250,
            seed=3,
        ).log
        made[name] = prepare(log, load_task(str(SLIDER)), split=NewSplit("none"))
    return made


def attribution(prepared, names) -> tuple[Attribution, ModelFits]:
    fits = ModelFits(prepared, 1)
    folds = select_folds(prepared.windows, prepared.split.is_test)
    candidates = [Candidate(Placed(name, on_slider(name, prepared.task.model))) for name in names]
    return Attribution(fits, folds, seed=0, candidates=candidates), fits


@pytest.mark.parametrize(
    ("log", "name", "shape", "tolerance"),
    [
        ("time", "periodic-disturbance", 2.29, 0.005),
        ("slow", "periodic-disturbance", 0.7, 0.005),  # 1.4 periods: believed as it leaves nothing
        ("space", "cogging", 0.097, 0.0005),
        ("motor", "torque-ripple", 0.097, 0.0005),
    ],
)
def test_a_force_that_repeats_is_found_wherever_its_frequency_lies(logs, log, name, shape, tolerance):
    search, fits = attribution(logs[log], PERIODIC)
    declared = fits.fit(search.models.fit_part, [], logs[log].task.space.nominal)
    assert lack_of_fit(declared.at).lacking
    last = search.run(declared)
    assert [a.name for a in search.answer.accepted] == [f"{name}@{on_slider(name).site}"]
    assert last.point[-1] == pytest.approx(shape, abs=tolerance)
    assert not lack_of_fit(last.at).lacking


def test_what_pulses_promise_is_what_the_simulated_effect_scores(logs):
    """The gain at the best frequency is that of the score test on the effect itself."""
    prepared = logs["time"]
    search, fits = attribution(prepared, PERIODIC)
    fit = fits.fit(search.models.fit_part, [], prepared.task.space.nominal)
    narrow = NarrowPeaks(fits, search.models.fit_part, fit)
    effect = REGISTRY.get("periodic-disturbance")(prepared.task.model, "x")
    points, tried = narrow.points(effect)
    assert tried > 50 and points[0, 2] == pytest.approx(2.29, abs=0.25)
    assert not any(narrow.doubts(effect, p) for p in points)
    pulses, response = narrow._response(effect)
    promised = narrow._gains(effect, points[:1], narrow._path(effect), pulses, response)[0]
    probes = points[[0, 0]] + 1e-3 * effect.space.span * np.eye(3)[:2]
    residual, _ = fits.probe(search.models.fit_part, fit, Placed("periodic-disturbance", effect), probes)
    sensitivity = np.moveaxis((fit.at.residual - residual) / 1e-3, 0, -1)
    found = score(fit.at, sensitivity, np.full(2, -1.0), np.ones(2))
    before = float(fit.at.objectives(fit.at.inflation).sum())
    exact = before / (1 + fit.at.data.count / found.gain)  # found.gain is per variance that would be left
    assert promised == pytest.approx(exact, rel=0.1)


def test_every_shape_tried_counts_where_nothing_is_missing(logs):
    search, fits = attribution(logs["none"], PERIODIC)
    declared = fits.fit(search.models.fit_part, [], logs["none"].task.space.nominal)
    assert search.extension.next(declared) is None
    told = {c.name: (c.shapes_tried, c.rejection) for c in search.answer.candidates}
    assert all(tried > 30 and why for tried, why in told.values()), told


def test_a_search_that_would_go_round_ends(logs, monkeypatch):
    """Whatever enters is taken out again at once."""

    def none_holds(answer, current):
        answer.accepted.clear()
        return declared

    search, fits = attribution(logs["time"], PERIODIC)
    declared = fits.fit(search.models.fit_part, [], logs["time"].task.space.nominal)
    monkeypatch.setattr(attribution_module, "backward", none_holds)
    assert search.run(declared) is declared
    assert search.answer.accepted == []


def test_a_model_has_one_time_step(logs):
    """Not a half, a quarter and an eighth of it at once."""
    effects = [REGISTRY.get("finer-time-step")(logs["none"].task.model, s) for s in ("half", "eighth")]
    assert len({e.variant_of for e in effects}) == 1


@dataclass
class Gained:
    gain: float


def test_what_had_nothing_to_act_on_is_asked_again(logs, monkeypatch):
    """As hard friction in a model without any, which acts once dry friction is found; what told little is not."""
    search, fits = attribution(logs["time"], PERIODIC)
    declared = fits.fit(search.models.fit_part, [], logs["time"].task.space.nominal)
    without_action, little, much = search.answer.candidates

    class Round:
        def __init__(self, models, current, asked, **_):
            self.scored = current
            for candidate, gain in ((without_action, 0.0), (little, 1e-3), (much, 1e6)):
                candidate.score = Gained(gain)

        def choose(self):
            return None

    monkeypatch.setattr(extension, "ForwardRound", Round)
    monkeypatch.setattr(search.models, "screening", lambda _: None)
    search.extension._by_simulation(declared)
    assert search.extension._asked_again(search.answer.candidates, declared) == [without_action, much]


@dataclass(frozen=True)
class Left:
    excess: float
    effects: tuple[Placed, ...] = ()


@pytest.mark.parametrize(("left", "searched"), [(2.0, 2), (19.9, 1)])
def test_a_search_goes_on_from_a_rival_that_explains_materially_more(logs, monkeypatch, left, searched):
    search, _ = attribution(logs["none"], PERIODIC)
    begun, swapped = [], Left(left)

    def with_more(current):
        begun.append(current)
        return current if current is swapped else Left(20.0)

    monkeypatch.setattr(search.models, "know", lambda _: None)
    monkeypatch.setattr(search.models, "is_explained", lambda _: False)
    monkeypatch.setattr(search, "_with_more", with_more)
    _leave_as_they_are(search, monkeypatch)
    monkeypatch.setattr(search.rivals, "ask", lambda _: None)
    monkeypatch.setattr(search.rivals, "compare", lambda *_: swapped)
    assert search._search(Left(100.0)) is swapped
    assert begun == [Left(100.0), swapped][:searched]


def test_a_search_asks_the_rivals_of_a_rival_that_explains_the_log_and_does_not_go_round(logs, monkeypatch):
    """The first takes the place of the second, which took the place of the first."""
    search, _ = attribution(logs["none"], PERIODIC)
    first, second = (Left(0.0, (c.placed,)) for c in search.answer.candidates[:2])
    asked = []
    monkeypatch.setattr(search.models, "know", lambda _: None)
    monkeypatch.setattr(search.models, "is_explained", lambda _: True)
    monkeypatch.setattr(search, "_with_more", lambda current: current if current.effects else first)
    monkeypatch.setattr(search.rivals, "ask", asked.append)
    _leave_as_they_are(search, monkeypatch)
    monkeypatch.setattr(search.rivals, "compare", lambda current, _: second if current is first else first)
    assert search._search(Left(100.0)) is first
    assert asked == [first, second]


def _leave_as_they_are(search: Attribution, patch: pytest.MonkeyPatch) -> None:
    """Nothing is dropped from models."""
    patch.setattr(search, "_keep", lambda current: current)
    for name in ("without_minor", "backward"):
        patch.setattr(attribution_module, name, lambda _, current: current)
