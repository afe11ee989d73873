"""What inputs do between the rows of a log, told by the force balance."""

from __future__ import annotations

import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from balances import Made
from case_logs import log_of
from diagnosing import look_among
from held_inputs import MACHINES
from setting_numbers import set_numbers

from benchmarks._planted_logs.cases import NOTHING, PLANTED, Case
from capture_cli.common.progress import Progress
from capture_cli.errors import OutOfTime
from capture_cli.estimate.log_balance import with_timings
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.noise.lack_of_fit import lack_of_fit
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.split import NewSplit
from capture_cli.log.input_sequences import EVENLY, HELD, Hold
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.base import Task
from capture_cli.options.diagnose import DiagnoseOptions
from capture_cli.select import input_readings
from capture_cli.select.candidates import all_candidates
from capture_cli.select.input_readings import read_instead, timings_with_effects
from capture_cli.select.search.answer import Accepted
from capture_cli.select.time_limit import TimeLimit
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.diagnose import _prepared, diagnose
from capture_cli.stages.log_to_fit import LogToFit
from capture_cli.stages.record import record
from capture_cli.store.provenance import Provenance

# what a search among a few has to find
ASKED = (
    "coulomb-friction",
    "direction-dependent-viscous",
    "viscous-damping",
    "control-delay",
    "control-gain",
)
# and one of commands alone
LIKE_A_GAIN = ("control-reverse-gain", "control-gain", "control-lag", "control-delay", "coulomb-friction")
LIKE_A_FILTER = ("control-second-order-lag", "sensor-low-pass", "reflected-inertia")
QUIET = {"threads": 1}


@pytest.mark.parametrize(
    ("machine", "dress", "commands"),
    [
        ("slider", "plain", 1),
        ("cart_pole", "half-rate", 2),
        ("slider", "quarter-rate", 4),
        ("pan_tilt", "quarter-rate", 4),  # parameters that held commands say are 10 % off
    ],
)
def test_the_log_tells_how_many_commands_there_are_from_row_to_row(machine, dress, commands):
    task, log = log_of(Case(NOTHING, machine, (), 1.0, 5, dress=dress, episodes=4))
    assert [c.hold for c in task.inputs] == [None] * len(task.inputs)
    prepared = prepare(log, task, **QUIET)
    assert [t.hold for t in prepared.input_timings] == [Hold(commands)] * len(task.inputs)
    assert [c.hold for c in prepared.task.inputs] == [Hold(commands)] * len(task.inputs)
    for timing in prepared.input_timings:
        assert timing.gain > 3 * timing.error


def of_a_machine(folder, machine: str, *effects: str) -> tuple[Task, MeasuredLog]:
    """A log whose commands are held for four steps of the model, made in steps that are 16 times shorter."""
    own = shutil.copytree(MACHINES / machine, folder / machine)
    task = load_task(str(MACHINES / machine / "task.toml"))
    model, step = own / "model.xml", f'timestep="{task.timestep:g}"'
    assert step in model.read_text()
    model.write_text(model.read_text().replace(step, f'timestep="{task.timestep / 16:g}"'))
    noise = {c.name: sd for c, sd in zip(task.outputs, 5 * (1e-4,), strict=False)}
    record(
        task=str(own / "task.toml"),
        out=folder / "log.zarr",
        effects=list(effects),
        noise=noise,
        episodes=3,
        duration=4.0,
        rate=0.25 / task.timestep,
        threads=1,
    )
    return task, MeasuredLog.read(folder / "log.zarr")


@pytest.mark.parametrize("machine", ["slider", "cart_pole"])
def test_held_inputs_of_a_machine_act_half_a_step_later_than_the_model_s_own(machine, tmp_path):
    task, log = of_a_machine(tmp_path, machine)
    prepared = prepare(log, task, **QUIET)
    assert set(prepared.task.holds) == {Hold(1.0, task.timestep / 2)}
    fit = ModelFits(prepared, 1).fit(prepared, [], task.space.nominal)
    assert not lack_of_fit(fit.at).lacking


def test_half_a_step_is_no_effect_of_the_machine(tmp_path, monkeypatch, without_pages):
    """Beside one that is: nothing else is found, and that at the right size."""
    look_among(
        monkeypatch, "cubic-stiffness", "control-delay", "sensor-delay", "control-lag", "finer-time-step"
    )
    task, log = of_a_machine(tmp_path, "slider", "cubic-stiffness@x=9000")
    out = tmp_path / "diagnosis"
    found = diagnose(real_log=log.path, task=str(task.path), out=out, threads=1, quiet=True).document
    assert [e["name"] for e in found["effects"]] == ["cubic-stiffness"]
    assert found["effects"][0]["parameters"]["stiffness"]["value"] == pytest.approx(9000, rel=0.01)
    assert {i["late"] for i in found["input_timing"]["inputs"].values()} == {task.timestep / 2}


def test_what_the_task_says_is_not_asked_again():
    task, log = log_of(Case(NOTHING, "slider", (), 1.0, 5, dress="half-rate"))
    task.inputs = tuple(replace(c, hold=HELD) for c in task.inputs)
    prepared = prepare(log, task, **QUIET)
    assert prepared.input_timings == () and set(prepared.task.holds) <= {HELD}


@pytest.mark.parametrize("machine", ["slider", "pan_tilt"])
def test_commands_that_are_written_a_row_late_act_before_their_rows(machine):
    task, log = log_of(Case(NOTHING, machine, (), 1.0, 5, dress="row-late", episodes=6))
    prepared = prepare(log, task, **QUIET)
    assert len(prepared.input_timings) == len(task.inputs)
    for timing in prepared.input_timings:
        assert timing.hold.commands == 1 and timing.hold.late == pytest.approx(-0.004)


@pytest.mark.parametrize(
    ("effect", "magnitude", "size", "dress", "commands"),
    [
        ("coulomb-friction@x", 3.0, 0.026, "plain", {1}),
        ("direction-dependent-viscous@x", 10.0, 0.13, "half-rate", {2}),
    ],
)
def test_where_an_effect_is_missing_it_is_told_with_the_effect_in(effect, magnitude, size, dress, commands):
    task, log = log_of(Case(PLANTED, "cart_pole", (effect,), magnitude, 3, dress=dress, episodes=6), size)
    prepared = prepare(log, task, **QUIET)
    assert prepared.input_timings == ()  # what is missing may look like another timing
    unread = replace(prepared, task=task)
    as_read = partial(prepare, log, **QUIET)
    candidates = [c for c in all_candidates(prepared) if c.placed.kind in ASKED]
    found, _ = timings_with_effects(unread, candidates, as_read, 1)
    (timing,) = found
    assert timing.hold.commands in commands
    assert with_timings(task, found).holds == (timing.hold,)


def test_where_two_effects_are_missing_it_is_told_with_both_in():
    """Either alone is best with the inputs read in its own way, and neither reading is surely better."""
    pair = ("sensor-bias@q2", "sensor-clock-rate")
    task, log = log_of(Case("pair", "arm", pair, 3.0, 275583650), 0.056, 0.017)
    prepared = prepare(log, task, **QUIET)
    few = [c for c in all_candidates(prepared) if c.name in pair]
    unread, as_read, told = replace(prepared, task=task), partial(prepare, log, **QUIET), []
    found, _ = timings_with_effects(unread, few, as_read, 1, on_step=lambda *step: told.append(step))
    assert told == [("balance", 0, 2), ("balance", 1, 2), ("reading", 0, 2), ("reading", 1, 2)]
    assert [t.hold for t in found] == [HELD, HELD]
    assert all(t.gain > 3 * t.error for t in found)


def test_what_leaves_far_more_than_noise_is_told_by_what_is_likelier():
    """Commands that are misread leave hundreds of times the noise with any effect in: no two are asked then."""
    name = "control-reverse-gain@tilt"
    task, log = log_of(Case(PLANTED, "pan_tilt", (name,), 10.0, 40039109, dress="quarter-rate"), 0.18)
    prepared = prepare(log, task, **QUIET)
    few = [c for c in all_candidates(prepared) if c.placed.kind in LIKE_A_GAIN]
    found, _ = timings_with_effects(replace(prepared, task=task), few, partial(prepare, log, **QUIET), 1)
    assert [t.hold for t in found] == [Hold(4.0)] * 2


def test_no_two_effects_are_asked_where_one_explains_the_log(monkeypatch):
    def grown(*_, **__):
        raise AssertionError("pairs were asked")

    monkeypatch.setattr(input_readings, "grown", grown)
    # the balance leaves more than noise, whatever is in
    set_numbers(monkeypatch, input_readings, else_missing=0.0)
    name = "coulomb-friction@x"
    task, log = log_of(Case(PLANTED, "cart_pole", (name,), 3.0, 3, episodes=6), 0.026)
    prepared = prepare(log, task, **QUIET)
    few = [c for c in all_candidates(prepared) if c.name == name]
    found, _ = timings_with_effects(replace(prepared, task=task), few, partial(prepare, log, **QUIET), 1)
    assert [t.hold for t in found] == [HELD]


def test_simulations_tell_where_the_balance_is_not_sure(monkeypatch):
    monkeypatch.setattr(input_readings, "is_surely_better", lambda *_: False)
    name = "direction-dependent-viscous@x"
    task, log = log_of(Case(PLANTED, "cart_pole", (name,), 10.0, 3, dress="quarter-rate", episodes=6), 0.13)
    prepared = prepare(log, task, **QUIET)
    few = [c for c in all_candidates(prepared) if c.name == name]
    asked, fit, fitting = (
        (replace(prepared, task=task), few, partial(prepare, log, **QUIET), 1),
        ModelFits.fit,
        [],
    )
    monkeypatch.setattr(ModelFits, "fit", lambda *a, **k: fitting.append(1) or fit(*a, **k))
    found, _ = timings_with_effects(*asked)
    assert [t.hold for t in found] == [Hold(4.0)]

    def out_of_time():
        if fitting:
            raise OutOfTime

    fitting.clear()
    with pytest.raises(OutOfTime):
        timings_with_effects(*asked, out_of_time)
    assert len(fitting) == 1


def test_a_log_without_a_balance_tells_nothing_and_its_inputs_are_held():
    task, log = log_of(Case(NOTHING, "puck", (), 1.0, 5, episodes=2))
    prepared = prepare(log, task, **QUIET)
    assert prepared.input_timings == () and set(prepared.task.holds) <= {HELD}


def test_where_the_declared_model_explains_the_log_by_inputs_that_change_evenly_effects_are_asked(tmp_path):
    """A supply that sags takes from a force what a later one would: in the balance that is less than noise."""
    seed = 669718904
    task, log = log_of(Case(PLANTED, "slider", ("control-supply-sag",), 3.0, seed), 0.18)
    assert prepare(log, task, split=NewSplit(seed=seed), **QUIET).task.holds == (EVENLY,)
    options = DiagnoseOptions(real_log=tmp_path / "log.zarr", out=tmp_path / "out", threads=1, seed=seed)
    to_fit = LogToFit(log, task, options, Provenance("diagnose", {}, {}))
    found = _prepared(to_fit, None, TimeLimit(), Progress("", "", quiet=True))
    assert found.task.holds == (HELD,)
    assert [t.hold for t in found.input_timings] == [HELD]


def test_a_reading_that_explains_the_log_by_simulation_needs_no_effect(tmp_path):
    """At 100 Hz the balance of a light finger leaves 8 times the noise: a filter and two commands a row fill it."""
    task = str(MACHINES / "finger" / "task.toml")
    out = tmp_path / "log.zarr"
    drive = {"episodes": 4, "duration": 3.954, "rate": 100.0, "noise": 2.032e-4}
    record(task=task, out=out, **drive, random_parameters=True, seed=1032)
    log, task = MeasuredLog.read(out), load_task(task)
    prepared = prepare(log, task, **QUIET)
    assert prepared.input_timings == ()
    few = [c for c in all_candidates(prepared) if c.placed.kind in LIKE_A_FILTER]
    found, _ = timings_with_effects(replace(prepared, task=task), few, partial(prepare, log, **QUIET), 1)
    assert [t.hold for t in found] == [HELD, HELD]


def test_two_commands_a_row_are_not_read_as_early_ones_with_an_effect():
    """An even change that comes early, and a lag of the motors, do as two commands a row do with no effect."""
    seed = 670167660
    task, log = log_of(Case(NOTHING, "arm", (), 1.0, seed, dress="half-rate"))
    prepared = prepare(log, task, split=NewSplit(seed=seed), **QUIET)
    few = [c for c in all_candidates(prepared) if c.name == "control-second-order-lag"]
    found, _ = timings_with_effects(replace(prepared, task=task), few, partial(prepare, log, **QUIET), 1)
    assert [t.hold for t in found] == [Hold(2.0)] * 2


@pytest.mark.parametrize(
    ("case", "sizes"),
    [
        # in the balance, to first order, commands that act a row early make up for a clock that is off by 1 %
        (Case(PLANTED, "cart_pole", ("sensor-clock-rate",), 3.0, 1587229418), (0.2066,)),
        # and by a part of what a spring leaves inputs that change evenly are ahead, whose delay is a lag of held ones
        (
            Case("pair", "arm", ("control-lag", "linear-stiffness@elbow"), 3.0, 994631157),
            (0.009586, 0.005292),
        ),
    ],
)
def test_inputs_are_held_where_a_balance_that_leaves_more_than_noise_says_otherwise(case, sizes):
    task, log = log_of(case, *sizes)
    prepared = prepare(log, task, split=NewSplit(seed=case.number), **QUIET)
    few = [c for c in all_candidates(prepared) if c.name in (*case.planted, "control-second-order-lag")]
    found, screening = timings_with_effects(
        replace(prepared, task=task), few, partial(prepare, log, **QUIET), 1
    )
    assert {t.hold for t in found} == {HELD}
    assert set(screening.balance.smoothed.task.holds) == {HELD}


def test_commands_a_row_are_told_beside_what_is_missing():
    """The declared model alone reads three, for what it lacks is late, too."""
    case = Case(PLANTED, "arm", ("linear-stiffness@shoulder",), 3.0, 1157506279, dress="half-rate")
    task, log = log_of(case, 0.002818)
    prepared_as = partial(prepare, log, split=NewSplit(seed=case.number), **QUIET)
    prepared = prepared_as(task)
    assert {t.hold for t in prepared.input_timings} == {Hold(3)}
    few = [c for c in all_candidates(prepared) if c.name in (*case.planted, "control-lag")]
    found, screening = timings_with_effects(replace(prepared, task=task), few, prepared_as, 1)
    assert {t.hold for t in found} == {Hold(2)} == set(screening.balance.smoothed.task.holds)


@pytest.mark.parametrize(("late", "held"), [((), True), ((0.05,), False)])
def test_inputs_are_held_after_all_where_what_was_found_explains_that_with_nothing_on_controls(late, held):
    """A clock that is off looks like commands that act early, which a delay then undoes; one that is there stays."""
    names = "sensor-clock-rate", "control-delay@drive"
    case = Case(PLANTED, "cart_pole", names[: 1 + len(late)], 3.0, 1587229418)
    task, log = log_of(case, 0.2066, *late)
    evenly, as_held = (prepare(log, task.with_holds([h]), **QUIET) for h in (Hold(np.inf, -0.007), HELD))
    clock, delay = (next(c.placed for c in all_candidates(evenly) if c.name == name) for name in names)
    last = ModelFits(evenly, 1).fit(evenly, [clock, delay], np.append(task.space.nominal, [0.0, 0.02]))
    both = [Accepted(placed, None, [], None, 0.5) for placed in (clock, delay)]
    assert (read_instead(both, last, lambda: as_held, 1) is as_held) == held
    assert read_instead(both[:1], last, lambda: as_held, 1) is None


@pytest.mark.parametrize("seed", [0, 1])
def test_a_late_sensor_does_not_make_up_for_inputs_that_are_misread(seed):
    # a joint's damping is no reason why the noise of a late sensor should look like less
    own = Made.of("finger", seed=seed)
    late = [p for p in own.placed if p.name in ("sensor-delay", "sensor-low-pass")]
    held = own.screening(late)
    declared = held.fits.fitted(replace(held.best(), effects=(), values=()))
    misread = held.read_as([EVENLY, EVENLY]).best()
    assert misread.effects
    assert misread.gain(declared)[0] < 5.0


@pytest.fixture(scope="module")
def giving() -> tuple[Task, MeasuredLog, PreparedLog]:
    """A table that gives, which moves one joint as if its commands changed evenly."""
    task, log = log_of(Case(PLANTED, "pan_tilt", ("base-compliance@y",), 2.2, 647467791), 0.27)
    return task, log, prepare(log, task, **QUIET)


@pytest.mark.parametrize(
    ("kind", "holds"), [("base-compliance", (HELD, HELD)), ("coulomb-friction", (EVENLY, HELD))]
)
def test_inputs_act_each_in_their_own_way_where_no_effect_with_all_alike_does_as_well(giving, kind, holds):
    task, log, prepared = giving
    assert prepared.task.holds == (EVENLY, HELD)
    few = [c for c in all_candidates(prepared) if c.placed.kind == kind]
    found, _ = timings_with_effects(replace(prepared, task=task), few, partial(prepare, log, **QUIET), 1)
    assert tuple(t.hold for t in found) == holds


def test_shorter_steps_take_inputs_later_by_half_of_their_own(tmp_path):
    """A mass without damping and spring is right to the second order in steps of any length, from its own speed on."""
    task, log = of_a_machine(tmp_path, "slider")
    prepared = prepare(log, task, **QUIET)
    point = np.where([p.name == "mass" for p in task.space], task.space.nominal, 0.0)
    finer = next(c.placed for c in all_candidates(prepared) if c.name == "finer-time-step@eighth")
    windows, initial = prepared.windows, prepared.initial.states
    own, short = (
        Simulator(prepared.task, effects, threads=1).simulate(windows, initial, point).outputs[0, ..., 0]
        for effects in ([], [finer])
    )
    steps = int(windows.samples.min())
    off = (own - short)[:, :steps].T
    ramp = np.stack([np.ones(steps), np.arange(steps)], axis=1)
    assert np.abs(off - ramp @ np.linalg.lstsq(ramp, off, rcond=None)[0]).max() < 5e-5
