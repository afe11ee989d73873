"""Fits of a model with effects: what a window's start has to leave free, and what is carried from model to model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from held_inputs import held_machine
from recorded_logs import record_log, true_values

from capture_cli.estimate.fit import SETTINGS as FIT
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.model_fits import Effort, ModelFits
from capture_cli.estimate.part_fit import PartFit
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.intervals import unit_covariance
from capture_cli.estimate.solve.linearization import Data, Linearization, Trial
from capture_cli.log.windows import SETTINGS as WINDOWS
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects._transmission import TransmissionEffect
from capture_cli.model.effects.base import Effect
from capture_cli.model.effects.placed import Placed
from capture_cli.model.parameters import ParameterSpace
from capture_cli.model.tasks import load_task
from capture_cli.select.candidates import all_candidates
from capture_cli.select.log_parts import select_folds
from capture_cli.select.minima import SETTINGS as MINIMA
from capture_cli.select.minima import minima
from capture_cli.select.model_comparison import ModelComparison
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.record import record


@pytest.mark.parametrize("seed", range(20))
def test_a_hidden_state_that_does_what_another_does_takes_nothing_and_no_less(seed):
    random = np.random.default_rng(seed)
    samples = np.zeros((1, 50, 1))
    data = Data(
        ParameterSpace([]),
        samples,
        np.ones_like(samples, dtype=bool),
        np.ones(1),
        np.ones((1, 3)),
        hidden_tried=np.zeros((1, 1)),
    )
    by_initial = random.standard_normal((1, 50, 3)) * 10 ** random.uniform(0, 6)
    by_initial[..., 2] = by_initial[..., 0]
    residual = random.standard_normal((1, 50))
    at = Linearization(data, np.zeros(0), np.zeros((1, 3)), residual, np.zeros((1, 50, 0)), by_initial)
    assert 0 <= at.taken_by_hidden.sum() < 0.1


def planted(
    folder: Path,
    effect: str,
    *,
    machine: str = "slider",
    task: Path | None = None,
    duration: float = 3.0,
    timestep: float = 0.004,
) -> tuple[PreparedLog, np.ndarray]:
    """A log with `effect` in it, cut into windows, and the true parameters, those of the effect last.

    Of a machine of the benchmarks, or of one's own: its `task`.
    """
    task = task or held_machine(folder / machine, machine, timestep)
    log = record_log(folder, task, effect, noise=3e-4, episodes=4, duration=duration, seed=0)
    return prepare(log, load_task(str(task))), true_values(folder)


def test_what_a_transmission_has_wound_up_before_a_window_is_a_nuisance(tmp_path, monkeypatch):
    prepared, truth = planted(tmp_path, "compliance@x.compliance=0.002")
    effect = REGISTRY.get("compliance")(prepared.task.model, "x")
    assert effect.states

    def error(fits: ModelFits) -> float:
        return fits.fit(prepared, [Placed("compliance", effect)], truth).error

    free = error(ModelFits(prepared, 1))
    _hold_hidden(monkeypatch)
    held = error(ModelFits(prepared, 1))
    assert free < 1.05 < held


def test_what_a_filter_reports_when_a_window_begins_is_a_nuisance(tmp_path, monkeypatch):
    prepared, truth = planted(tmp_path, "sensor-low-pass@q.time_constant=0.04")
    effect = Placed("sensor-low-pass", REGISTRY.get("sensor-low-pass")(prepared.task.model, "q"))
    fits = ModelFits(prepared, 1)
    free = fits.fit(prepared, [effect], truth)
    _hold_hidden(monkeypatch)
    held = fits.fit(prepared, [effect], truth)
    assert free.error < 1.05 < held.error


@pytest.mark.parametrize(
    ("name", "site", "text"),
    [
        ("control-lag", "drive", "time_constant=0.05"),
        ("control-second-order-lag", "drive", "time_constant=0.03"),
        ("control-delay", "drive", "delay=0.09"),
        ("sensor-delay", "q", "delay=0.09"),
    ],
)
def test_what_an_actuator_was_told_before_an_episode_is_a_nuisance(tmp_path, name, site, text, monkeypatch):
    """Logs that begin while the machine is driven: their first half second is cut off."""
    prepared, truth = planted(tmp_path, f"{name}@{site}.{text}")
    log = prepared.log
    kept = [np.arange(e.start + 125, e.stop) for e in log.episodes]
    steps, ends = np.concatenate(kept), np.cumsum([len(k) for k in kept])
    late = replace(
        log, time=log.time[steps], inputs=log.inputs[steps], outputs=log.outputs[steps], episode_ends=ends
    )
    prepared = prepare(late, prepared.task)
    effect = REGISTRY.get(name)(prepared.task.model, site)
    if len(effect.parameters) > 1:
        truth = np.append(truth, [1.0] * (len(prepared.task.space) + len(effect.parameters) - len(truth)))
    free = ModelFits(prepared, 1).fit(prepared, [Placed(name, effect)], truth)
    windows = prepared.windows
    later = Simulator(prepared.task, [Placed(name, effect)]).hidden_sd(windows)[:, -1] == 0
    assert later[windows.elapsed > 0.3 * WINDOWS.lead].all() and not later[windows.elapsed == 0].any()
    assert (
        later.any()
        and np.all(free.corrections[later, -1] == 0)
        and np.all(free.corrections[windows.elapsed == 0, -1] != 0)
    )
    assert 0 < free.at.taken_by_hidden.sum() <= (~later).sum()
    without = ModelFits(prepared, 1).fit(prepared.part(later), [Placed(name, effect)], truth)
    assert without.at.taken_by_hidden.sum() == 0
    monkeypatch.setattr(type(effect), "states", ())
    monkeypatch.setattr(type(effect), "before", Effect.before)
    held = ModelFits(prepared, 1).fit(prepared, [Placed(name, effect)], truth)
    first = [float(np.sqrt(np.square(f.at.residual[~later]).mean())) for f in (free, held)]
    assert free.error < 1.05
    assert first[0] < 0.95 * first[1]


def test_what_the_logs_clock_shows_does_not_matter(tmp_path, began=1.7e9):
    prepared, truth = planted(tmp_path, "periodic-disturbance@x.sine=20")
    log = replace(prepared.log, time=prepared.log.time + began)
    later = prepare(log, prepared.task)
    effect = Placed("periodic-disturbance", REGISTRY.get("periodic-disturbance")(prepared.task.model, "x"))
    fits = [ModelFits(p, 1).fit(p, [effect], truth) for p in (prepared, later)]
    np.testing.assert_allclose(fits[1].at.by_parameter, fits[0].at.by_parameter, rtol=1e-3, atol=0.1)
    assert abs(fits[1].point[-1] - 1.0) < 0.01, "Hz"
    assert fits[1].error == pytest.approx(fits[0].error, rel=1e-3)
    assert log.time[0] == began, "the log keeps its clock"


def test_a_machine_driven_by_the_inputs_of_a_log_begins_with_it(tmp_path):
    prepared, _ = planted(tmp_path, "coulomb-friction@x=2")
    options = {
        "task": str(prepared.task.path),
        "effects": ["control-fade@drive=-0.5", "periodic-disturbance@x.sine=20"],
    }
    recorded = []
    for began in (0.0, 1.7e9):
        (tmp_path / "clock.zarr").mkdir(exist_ok=True)
        log = replace(prepared.log, time=prepared.log.time + began)
        log.write(tmp_path / "clock.zarr")
        made = record(**options, out=tmp_path / "again.zarr", inputs_from=tmp_path / "clock.zarr", force=True)
        assert np.array_equal(made.log.time, log.time)
        recorded.append(made.log.outputs)
    np.testing.assert_allclose(*recorded, atol=1e-6)


@pytest.mark.parametrize("delay", [0.02, 0.2])
@pytest.mark.parametrize("sensor", ["pole", ""])
def test_a_window_of_a_late_sensor_begins_with_what_it_saw_before(tmp_path, sensor, delay):
    """Of a pole that swings at some 5 rad/s a fifth of a second ago was elsewhere."""
    prepared, truth = planted(
        tmp_path, f"sensor-delay@{sensor}.delay={delay}".replace("@.", "."), machine="cart_pole"
    )
    effect = Placed("sensor-delay", REGISTRY.get("sensor-delay")(prepared.task.model, sensor))
    fit = ModelFits(prepared, 1).fit(prepared, [effect], truth, effort=Effort(tolerance=FIT.exact))
    assert fit.error < 1.05
    assert fit.point[-1] == pytest.approx(delay, abs=5e-4)


@pytest.mark.parametrize("error", [-0.012, 0.012])
@pytest.mark.parametrize("sensor", ["cart", "pole"])
def test_a_window_of_a_sensor_with_a_clock_of_its_own_reads_what_was_or_comes(tmp_path, sensor, error):
    """At the end of an episode of three seconds it is ahead of the other one, or behind it, by 36 ms."""
    name = "sensor-own-clock"
    prepared, truth = planted(tmp_path, f"{name}@{sensor}.error={error}", machine="cart_pole")
    effect = Placed(name, REGISTRY.get(name)(prepared.task.model, sensor))
    fit = ModelFits(prepared, 1).fit(prepared, [effect], truth, effort=Effort(tolerance=FIT.exact))
    assert fit.error < 1.05
    assert fit.point[-1] == pytest.approx(error, abs=2e-4)


def test_a_fit_that_stays_far_above_what_is_asked_of_it_is_given_up(tmp_path):
    prepared, truth = planted(tmp_path, "coulomb-friction@x.friction=6")
    effect = Placed("coulomb-friction", REGISTRY.get("coulomb-friction")(prepared.task.model, "x"))
    fits, start = ModelFits(prepared, 1), truth[: len(prepared.task.space)]
    assert not fits.fit(prepared, [], start, effort=Effort(to_reach=1.1)).finished
    assert fits.fit(prepared, [], start).finished
    assert fits.fit(prepared, [effect], truth, effort=Effort(to_reach=1.1)).error < 1.1


def test_a_model_is_known_by_its_effects_in_the_order_of_its_parameters(tmp_path):
    prepared, truth = planted(tmp_path, "coulomb-friction@x=2")
    names = "coulomb-friction", "cubic-stiffness"
    placed = [Placed(n, REGISTRY.get(n)(prepared.task.model, "x")) for n in names]
    folds = select_folds(prepared.windows, prepared.split.is_test)
    models = ModelComparison(ModelFits(prepared, 1), folds, seed=0)
    point = np.append(truth, 0.0)
    first = models.fits.fit(models.fit_part, placed, point)
    models.know(first)
    assert models.fit(placed, point, first) is first
    turned = models.fit(placed[::-1], point[[0, 1, 2, 4, 3]], first)
    assert [name for name, _ in turned.effects] == ["cubic-stiffness", "coulomb-friction"]
    np.testing.assert_allclose(turned.point[[0, 1, 2, 4, 3]], first.point, rtol=1e-2, atol=0.5)


def test_a_larger_model_does_not_end_above_a_smaller_one(tmp_path):
    prepared, truth = planted(tmp_path, "coulomb-friction@x=2")
    names = "cubic-stiffness", "coulomb-friction"
    placed = [Placed(n, REGISTRY.get(n)(prepared.task.model, "x")) for n in names]
    fits = ModelFits(prepared, 1)
    near = fits.fit(prepared, placed[1:], truth)
    far = np.r_[truth[:-1], placed[0].effect.space.high, 0.0]
    short = Effort(rounds=1)
    assert fits.fit(prepared, placed, far, corrections=near.corrections[:, :2], effort=short).error > 2
    begun_again = fits.fit(prepared, placed, far, near=near, effort=short)
    assert [e.name for e in begun_again.effects] == [e.name for e in placed]
    assert begun_again.error <= near.error + 1e-6


def test_windows_that_begin_on_the_wrong_side_of_a_wide_play_are_begun_elsewhere(tmp_path, monkeypatch):
    prepared, truth = planted(tmp_path, "backlash@x.width=0.06", timestep=0.002)
    placed = [Placed("backlash", REGISTRY.get("backlash")(prepared.task.model, "x"))]

    fits = ModelFits(prepared, 1)
    narrower = truth.copy()
    narrower[-len(placed[0].effect.parameters)] *= 0.8
    descended = fits.fit(prepared, placed, narrower, effort=Effort(escapes=False))
    escaped = fits.escaped(prepared, placed, descended.point, near=descended, effort=Effort())
    assert escaped.error < 1.05 < descended.error
    assert fits.on(prepared, escaped).normalized < 1.1
    with monkeypatch.context() as patch:  # of play a fit escapes without being asked to
        patch.setattr(ModelFits, "_escaped", lambda *_: escaped)
        assert fits.fit(prepared, placed, narrower, effort=Effort(rounds=1)) is escaped
    monkeypatch.setattr(TransmissionEffect, "states_tried", np.zeros((0, 0)))
    assert ModelFits(prepared, 1).fit(prepared, placed, narrower).error > 1.1


def test_windows_that_a_trial_does_not_concern_are_not_simulated(tmp_path):
    prepared, truth = planted(tmp_path, "sensor-low-pass@q.time_constant=0.04")
    fits = ModelFits(prepared, 1)
    simulator = fits.simulator([])
    points, corrections = np.tile(truth[:-1], (2, 1)), np.zeros((2, *prepared.initial.sd.shape))
    corrections[1] = 0.1 * prepared.initial.sd
    every, _ = prepared.evaluate(simulator, Trial(points, corrections))
    which, before = np.array([1, 4]), fits.rollouts
    some, diverged = prepared.evaluate(simulator, Trial(points, corrections, which))
    assert fits.rollouts - before == 4
    seen = prepared.windows.sampled[which]
    assert np.array_equal(some[:, which] * seen, every[:, which] * seen)
    assert not diverged[:, which].any() and np.delete(diverged, which, axis=1).all()


def test_a_free_number_in_every_window_does_not_make_a_model_the_better_one(tmp_path, monkeypatch):
    """A filter this fast has forgotten what was before within a sample: its states fit the first samples' noise."""
    prepared, truth = planted(tmp_path, "sensor-low-pass@q.time_constant=0.002")
    effect = Placed("sensor-low-pass", REGISTRY.get("sensor-low-pass")(prepared.task.model, "q"))
    fits, windows = ModelFits(prepared, 1), len(prepared.windows)

    def fitted_and_judged() -> tuple[Fit, PartFit]:
        fit = fits.fit(prepared, [effect], truth, effort=Effort(tolerance=FIT.exact))
        return fit, fits.on(prepared, fit, tolerance=FIT.exact)

    free, judged = fitted_and_judged()
    _hold_hidden(monkeypatch)
    held, judged_held = fitted_and_judged()
    for hidden in (free.at.taken_by_hidden, judged.taken_by_hidden):
        assert 0.9 * windows < hidden.sum() <= windows
    assert held.at.taken_by_hidden.sum() == judged_held.taken_by_hidden.sum() == 0
    for one, other in ((free, held), (judged, judged_held)):
        left, left_held = (np.square(getattr(f, "at", f).residual).sum() for f in (one, other))
        squares, squares_held = np.sum(one.penalised_squares), np.sum(other.penalised_squares)
        assert left < squares and left_held == pytest.approx(squares_held)
        taken = np.sum(getattr(one, "at", one).taken_by_hidden)
        assert left_held - left == pytest.approx(taken, abs=2 * np.sqrt(2 * taken)), "by chance alone"
        assert abs(squares - squares_held) < 0.5 * (left_held - left)
    assert judged.blocks(1000).sum() == pytest.approx(judged.penalised_squares.sum())


def test_what_many_hidden_states_take_of_few_samples_is_counted_in_full():
    """Of ten numbers of white noise in a window a fit of four states leaves six squares."""
    windows, rows, states = 2000, 10, 4
    generator = np.random.default_rng(0)
    shape = (windows, rows, 1)
    free, tried = np.ones((windows, states)), np.zeros((0, states))
    data = Data(
        ParameterSpace([]), np.zeros(shape), np.ones(shape, bool), np.ones(1), free, hidden_tried=tried
    )
    shown = 1e3 * generator.standard_normal((windows, rows, states))
    noise, basis = generator.standard_normal((windows, rows, 1)), np.linalg.qr(shown)[0]
    left = (noise - basis @ (basis.swapaxes(1, 2) @ noise))[..., 0]
    at = Linearization(data, np.zeros(0), 0 * free, left, np.zeros((windows, rows, 0)), shown)
    four_sd = 4 * np.sqrt(2 / (windows * (rows - states)))
    assert np.square(left).sum() == pytest.approx(windows * (rows - states), rel=four_sd)
    for squares in (
        Fit((), data.space, np.zeros(0), at).penalised_squares,
        PartFit.of(at).penalised_squares.sum(),
    ):
        assert squares == pytest.approx(windows * rows, rel=four_sd)


def _hold_hidden(monkeypatch) -> None:
    """From here on hidden states are 0 in every window."""
    data = PreparedLog.data

    def held(self, simulator):
        free = data(self, simulator)
        sd = free.initial_sd.copy()
        sd[:, self.initial.sd.shape[1] :] = 0.0
        return replace(free, initial_sd=sd, hidden_tried=free.hidden_tried[:0])

    monkeypatch.setattr(PreparedLog, "data", held)


def test_offsets_of_the_machine_are_carried_to_another_model_and_hidden_ones_are_not(tmp_path):
    prepared, truth = planted(tmp_path, "compliance@x.compliance=0.002")
    effect = REGISTRY.get("compliance")(prepared.task.model, "x")
    fits = ModelFits(prepared, 1)
    size = len(prepared.task.space)
    declared = fits.fit(prepared, [], truth[:size], effort=Effort(tolerance=FIT.exact))
    rich = fits.fit(
        prepared,
        [Placed("compliance", effect)],
        truth,
        corrections=declared.corrections,
        effort=Effort(rounds=3),
    )
    assert rich.corrections.shape[1] == declared.corrections.shape[1] + len(effect.states)
    assert np.abs(rich.corrections[:, -2:]).max() > 0
    back = fits.fit(
        prepared, [], truth[:size], corrections=rich.corrections, effort=Effort(tolerance=FIT.exact)
    )
    assert back.penalised_squares == pytest.approx(declared.penalised_squares, rel=1e-2)
    residuals, diverged = fits.probe(prepared, declared, Placed("compliance", effect), truth[None, size:])
    assert residuals.shape[0] == 1 and not diverged.any()


def test_where_the_error_is_smooth_a_descent_comes_back(tmp_path):
    prepared, _ = planted(tmp_path, "coulomb-friction@x.friction=0.5")
    fits = ModelFits(prepared, 1)
    effect = Placed("coulomb-friction", REGISTRY.get("coulomb-friction")(prepared.task.model, "x"))
    fit = fits.fit(
        prepared, [effect], np.append(prepared.task.space.nominal, 0.3), effort=Effort(tolerance=FIT.exact)
    )
    found = minima(fits, prepared, fit, seed=0)
    assert len(found) == 2
    sd = np.sqrt(np.diag(unit_covariance(fit.at)[0]))
    np.testing.assert_array_less(np.abs(found[0].at.x - found[1].at.x), MINIMA.returned * sd)
    assert found[0].at.objectives(1.0).sum() <= found[1].at.objectives(1.0).sum()


SCANNER = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body><joint name="roll" axis="1 0 0" damping=".01"/><geom size=".06" mass=".4" contype="0"/>
    <body name="head"><joint name="pitch" axis="0 1 0" damping=".01"/>
      <geom type="cylinder" pos="0 0 -.02" size=".05 .04" mass=".8" contype="0"/></body></body></worldbody>
  <actuator><motor name="roll" joint="roll" ctrlrange="-.2 .2" ctrllimited="true"/>
    <motor name="pitch" joint="pitch" ctrlrange="-.2 .2" ctrllimited="true"/></actuator>
  <sensor><jointpos name="roll" joint="roll"/><jointpos name="pitch" joint="pitch"/></sensor>
</mujoco>
"""
SCANNER_TASK = """
format = 1
name = "scanner"
model = "model.xml"
parameters.damping = { set = ["joint:roll:damping", "joint:pitch:damping"], low = 0.0, high = 0.1, unit = "N m s/rad" }
inputs.roll = { column = "drive_roll", unit = "N m" }
inputs.pitch = { column = "drive_pitch", unit = "N m" }
outputs.roll = { column = "roll", unit = "rad" }
outputs.pitch = { column = "pitch", unit = "rad" }
log = { time = "t", window = 0.5 }
"""


def test_what_nothing_shows_stays_where_it_is(tmp_path):
    """Momentum along the pitch axis turns neither joint; what rounding shows of it took it to an end of its range."""
    (tmp_path / "model.xml").write_text(SCANNER)
    (tmp_path / "task.toml").write_text(SCANNER_TASK)
    prepared, truth = planted(tmp_path, "internal-momentum@head.z=1e-3", task=tmp_path / "task.toml")
    effect = REGISTRY.get("internal-momentum")(prepared.task.model, "head")
    placed, fits = Placed("internal-momentum", effect), ModelFits(prepared, 1)
    for begin in (0.0, -5e-4):
        fit = fits.fit(prepared, [placed], np.array([truth[0], 0.0, 0.0, begin]))
        assert fit.point[3] == pytest.approx(1e-3, rel=0.05) and fit.error < 1.05
        assert abs(fit.point[2]) < 1e-3 * effect.space.high[1]


@pytest.mark.parametrize("effect", ["loose-mass@x.mass=0.5", "viscoelastic-spring@x.stiffness=20"])
def test_a_loose_mass_begins_as_the_log_shook_it_and_so_stands_in_for_nothing_else(tmp_path, effect):
    """Free in each window, 1.7 and 1.3 times the noise would be left of 188 and 7."""
    prepared, truth = planted(tmp_path, effect)
    folds = select_folds(prepared.windows, prepared.split.is_test)
    models = ModelComparison(ModelFits(prepared, 1), folds, seed=0)
    [loose] = [c.placed for c in all_candidates(prepared) if c.name == "loose-mass@x"]
    declared = models.fits.fit(models.fit_part, [], truth[: len(prepared.task.space)])
    start = loose.effect.space.from_unit(np.array([0.5, 0.08, 0.05]))
    fit = models.fit([loose], np.append(declared.point, start), declared)
    if effect.startswith("loose-mass"):
        assert fit.error < 1.05
        assert fit.point[fit.columns(loose.name)] == pytest.approx(truth[-3:], rel=0.02)
    else:
        assert fit.error > 0.8 * declared.error


@pytest.fixture(scope="module")
def coulomb(tmp_path_factory) -> tuple[ModelFits, Fit, PreparedLog]:
    """Fits of a slider with dry friction, and the declared one, which lacks it."""
    prepared, truth = planted(tmp_path_factory.mktemp("coulomb"), "coulomb-friction@x.friction=2")
    fits = ModelFits(prepared, 1)
    declared = fits.fit(prepared, [], truth[: len(prepared.task.space)], effort=Effort(tolerance=FIT.exact))
    return fits, declared, prepared


def _beside(declared: Fit, fits: ModelFits, name: str, site: str, material: float) -> tuple[Fit, int]:
    """The fit with an effect begun at a third of its range, and how many windows it took."""
    effect = REGISTRY.get(name)(fits.prepared.task.model, site)
    own = effect.space.nominal + 0.3 * (effect.space.high - effect.space.nominal)
    start, before = np.concatenate([declared.point, own]), fits.rollouts
    effort = Effort(material=material)
    fit = fits.fit(fits.prepared, [Placed(f"{name}@{site}", effect)], start, near=declared, effort=effort)
    return fit, fits.rollouts - before


def test_an_effect_whose_score_test_promises_too_little_is_not_fitted(coulomb):
    fits, declared, prepared = coulomb
    slight, few = _beside(declared, fits, "quadratic-drag", "x", 0.5 * declared.error)
    assert not slight.finished
    assert 0.5 * declared.error < slight.promised <= declared.error
    assert slight.error == pytest.approx(declared.error)
    assert few <= 2 * len(prepared.windows)
    whole, many = _beside(declared, fits, "quadratic-drag", "x", np.inf)
    assert whole.finished and many > 4 * few
    assert whole.error > 0.5 * declared.error  # it was right to promise little
    found, _ = _beside(declared, fits, "coulomb-friction", "x", 0.5 * declared.error)
    assert found.finished and found.error < 1.1


def test_what_begins_at_a_threshold_has_no_score_test_and_is_fitted(coulomb):
    fits, declared, prepared = coulomb
    _, many = _beside(declared, fits, "control-saturation", "drive", 0.5 * declared.error)
    assert many > 4 * len(prepared.windows)


def test_an_effect_with_a_kink_at_null_has_its_score_test_on_the_side_of_its_start(tmp_path):
    """A joint without friction has its own in backward motion alone, or in forward motion alone."""
    prepared, truth = planted(tmp_path, "direction-dependent-coulomb@x.asymmetry=-2")
    fits = ModelFits(prepared, 1)
    declared = fits.fit(prepared, [], truth[:-1])
    placed = [
        Placed(
            "direction-dependent-coulomb",
            REGISTRY.get("direction-dependent-coulomb")(prepared.task.model, "x"),
        )
    ]
    material = Effort(material=0.3 * declared.error)
    backward = fits.fit(prepared, placed, np.append(declared.point, -1.5), near=declared, effort=material)
    assert backward.finished and backward.error < 1.1
    forward = fits.fit(prepared, placed, np.append(declared.point, 1.5), near=declared, effort=material)
    assert not forward.finished and forward.promised > material.material


def test_a_descent_begins_where_it_is_told_to_beside_a_fit_of_the_same_model(tmp_path):
    prepared, truth = planted(tmp_path, "coulomb-friction@x.friction=0.5")
    fits = ModelFits(prepared, 1)
    placed = [Placed("coulomb-friction", REGISTRY.get("coulomb-friction")(prepared.task.model, "x"))]
    fit = fits.fit(prepared, placed, truth)
    begin = 1.5 * fit.point
    assert fits.fit(prepared, placed, begin, near=fit, effort=Effort(rounds=1)).point == pytest.approx(begin)
