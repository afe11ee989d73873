"""The integral term of a position servo: found where it is planted, and followed through the log before a window."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from begun_inside import begun_inside
from diagnosing import diagnose, look_among
from held_inputs import MACHINES, held_machine
from machines import away, build, run
from plain_loop import looped
from recorded_logs import record_log, true_values

from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.split import NewSplit
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model import effects
from capture_cli.model.effects.companion import companion_module
from capture_cli.model.effects.servo_integral import IntegralTerm, ServoIntegral
from capture_cli.model.fields import ModelFields
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.base import Task
from capture_cli.select.candidates import Candidate, all_candidates, score_at_null
from capture_cli.select.narrow_peaks import NarrowPeaks
from capture_cli.simulate.engine import Engine
from capture_cli.stages.record import record

EMPS = Path(__file__).parents[1] / "docs" / "examples" / "emps" / "model.xml"
EFFECT = "servo-integral@tilt"
KI, LIMIT = 8.0, 0.02  # N m/(rad s), rad s: it is at its limit again and again
PLANTED = (f"{EFFECT}.ki={KI}", f"{EFFECT}.limit={LIMIT}")
# what it could be taken for
BESIDE_INTEGRAL = (
    "control-gain",
    "control-lag",
    "coulomb-friction",
    "linear-stiffness",
    "hysteretic-friction",
)


def recorded(folder: Path, *planted: str, duration: float = 4.0) -> tuple[MeasuredLog, np.ndarray]:
    """A log of the pan-tilt, and the true parameters, those of the effects last."""
    task = held_machine(folder / "pan_tilt", "pan_tilt", 0.004)
    log = record_log(folder, task, *planted, noise=1e-3, episodes=6, duration=duration, seed=3)
    return log, true_values(folder)


def without(log: MeasuredLog, since: float, until: float) -> MeasuredLog:
    """The log without what was then in each episode, s from its start."""
    elapsed = np.concatenate([log.time[e] - log.time[e.start] for e in log.episodes])
    keep = (elapsed < since) | (elapsed >= until)
    ends = np.cumsum([np.count_nonzero(keep[e]) for e in log.episodes])
    return replace(
        log, time=log.time[keep], inputs=log.inputs[keep], outputs=log.outputs[keep], episode_ends=ends
    )


def pan_tilt(folder: Path) -> Task:
    """The task of the logs that were recorded there."""
    return load_task(str(folder / "pan_tilt" / "task.toml"))


def fitted(log: MeasuredLog, task: Task, limited: bool = True):
    """The effect, a fit with it that begins at half of its size, and the prepared log."""
    prepared = prepare(log, task)
    effect = next(c.placed for c in all_candidates(prepared) if c.name == EFFECT)
    limit = 1.5 * LIMIT if limited else effect.effect.space.high[1]
    begin = np.array([*prepared.task.space.nominal, KI / 2, limit])
    return effect, ModelFits(prepared, 1).fit(prepared, [effect], begin), prepared


def test_an_integral_term_is_found_with_its_gain_and_its_limit(tmp_path, monkeypatch):
    look_among(monkeypatch, "servo-integral", *BESIDE_INTEGRAL)
    log, _ = recorded(tmp_path, *PLANTED, duration=2.5)
    document = diagnose(log, pan_tilt(tmp_path), seed=0)
    [found] = document["effects"]
    assert (found["name"], found["site"]) == ("servo-integral", "tilt")
    size = {name: p["value"] for name, p in found["parameters"].items()}
    assert size == pytest.approx({"ki": KI, "limit": LIMIT}, rel=0.05)
    before, after = (document[when]["test"]["normalized"] for when in ("before", "after"))
    assert after < 1.1 < 2 < before


@pytest.mark.parametrize("planted", [PLANTED, PLANTED[:1]], ids=["clamped", "unlimited"])
def test_what_it_was_when_the_log_began_need_not_be_known(planted, tmp_path):
    log, _ = recorded(tmp_path, *planted)
    _, fit, _ = fitted(without(log, 0.0, 1.1), pan_tilt(tmp_path), limited=planted == PLANTED)
    assert fit.error < 1.1
    assert fit.point[-2] == pytest.approx(KI, rel=0.05)


def test_what_it_was_after_a_gap_need_not_be_known(tmp_path):
    log, truth = recorded(tmp_path, *PLANTED, duration=3.0)
    prepared = prepare(without(log, 0.9, 1.7), pan_tilt(tmp_path))
    effect = next(c.placed for c in all_candidates(prepared) if c.name == EFFECT)
    assert len(effect.effect.seen.stretches) == 2 * len(log.episodes)
    assert ModelFits(prepared, 1).fit(prepared, [effect], truth).error < 1.1


ROD = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body><joint name="j" axis="0 1 0" damping=".2"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1"/>
    </body>
  </worldbody>
  <actuator><position name="p" joint="j" kp="40" kv="2" ctrlrange="-1 1"/></actuator>
  <sensor><jointpos name="q" joint="j"/></sensor>
</mujoco>
"""
ROD_TASK = """
format = 1
name = "rod"
model = "model.xml"
[inputs.p]
column = "p"
unit = "rad"
[outputs.q]
column = "q"
unit = "rad"
[parameters.d]
set = "joint:j:damping"
low = 0.05
high = 1.0
unit = "N m s/rad"
"""


def test_windows_after_a_gap_are_found_where_the_integral_is_at_its_limit(tmp_path):
    (tmp_path / "model.xml").write_text(ROD)
    task = tmp_path / "task.toml"
    task.write_text(ROD_TASK)
    planted = ("servo-integral@p.ki=60", "servo-integral@p.limit=0.05")
    options = {"episodes": 1, "duration": 8.0, "rate": 100.0, "noise": 1e-4, "band": (0.1, 1.0), "seed": 0}
    record(task=str(task), out=tmp_path / "log.zarr", effects=planted, **options)
    log = without(MeasuredLog.read(tmp_path / "log.zarr"), 3.0, 4.3)
    prepared = prepare(log, load_task(str(task)), window=0.5, split=NewSplit("none"))
    effect = only_candidate(prepared).placed
    assert ModelFits(prepared, 1).fit(prepared, [effect], np.array([0.2, 60.0, 0.05])).error < 1.1


def test_it_is_scored_with_what_it_may_have_held_before_the_log_began(tmp_path, monkeypatch):
    weak = ROD.replace(
        'kp="40" kv="2"', 'kp="6" kv=".4" gear="1.5"'
    )  # what holds the rod is mostly the integral
    (tmp_path / "model.xml").write_text(weak)
    task = tmp_path / "task.toml"
    task.write_text(ROD_TASK)
    planted = ("servo-integral@p.ki=12", "servo-integral@p.limit=0.5")
    options = {"episodes": 2, "duration": 4.5, "rate": 100.0, "noise": 5e-4, "seed": 3}
    record(task=str(task), out=tmp_path / "log.zarr", effects=planted, **options)
    log = without(MeasuredLog.read(tmp_path / "log.zarr"), 0.0, 1.5)
    prepared = prepare(log, load_task(str(task)), window=0.5, split=NewSplit("none"))
    fits, candidate = ModelFits(prepared, 1), only_candidate(prepared)
    declared = fits.fit(prepared, [], prepared.task.space.nominal)

    def gain() -> float:
        score_at_null(NarrowPeaks(fits, prepared, declared), candidate)
        return candidate.score.gain

    informed = gain()
    assert candidate.start_elsewhere is not None  # another limit: at this one it may stay
    monkeypatch.setattr(ServoIntegral, "states_scored", np.zeros((1, 0)))
    assert informed > 2 * gain()


def only_candidate(prepared) -> Candidate:
    return next(c for c in all_candidates(prepared) if c.name == "servo-integral@p")


def test_what_was_before_a_window_is_followed_through_the_errors_measured(tmp_path):
    log, truth = recorded(tmp_path, *PLANTED)
    placed, fit, prepared = fitted(log, pan_tilt(tmp_path))
    assert fit.error < 1.1
    np.testing.assert_allclose(fit.point[-2:], [KI, LIMIT], rtol=0.05)
    placed.effect.integral = lambda *, begins, **_: np.zeros(len(begins.first))
    assert ModelFits(prepared, 1).fit(prepared, [placed], truth).error > 2


def test_it_sits_at_position_servos_of_joints():
    sites = effects.REGISTRY.get("servo-integral").sites
    assert sites(load_task(str(MACHINES / "pan_tilt" / "task.toml")).model) == ["pan", "tilt"]
    assert sites(mujoco.MjModel.from_xml_path(str(EMPS))) == []
    others = """<velocity joint="x" kv="3"/><motor joint="x"/><position joint="x" kp="2" timeconst="0.1"/>
      <general joint="x" gainprm="5" biastype="affine" biasprm="0 -5 -1"/><intvelocity joint="x" kp="3"/>"""
    assert sites(build(SERVO.replace("{}", "").replace("<position", others + "<position"))) == ["#3", "servo"]


SERVO = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody>
    <body><joint name="x" type="slide" axis="1 0 0" damping="20"/><geom size=".1" mass="1"/></body>
  </worldbody>
  <actuator><position name="servo" joint="x" gear="2" kp="50" kv="4" {}/></actuator>
  <sensor><jointpos joint="x"/><actuatorfrc actuator="servo"/></sensor>
</mujoco>
"""


def stepped(model: mujoco.MjModel, ki: float, limit: float, steps: int, start: float = 0.0) -> np.ndarray:
    """Position and actuator force (step, 2) after a step of the set point to 0.1 m."""
    effect = effects.REGISTRY.get("servo-integral")(model, "servo")
    initial = InitialStates(np.full((1, 1), start), np.zeros((1, 1)), np.zeros((1, 0)), np.zeros(1))
    tape = np.full((1, steps, 1), 0.1)
    return run(model, (effect, np.array([[ki, limit]])), tape=tape, initial=initial)[0][0]


def test_it_takes_a_constant_load_until_it_is_at_its_limit():
    spring = build(SERVO.replace('damping="20"', 'damping="20" stiffness="100"').replace("{}", ""))
    position, force = stepped(spring, 200.0, 0.1, 4000)[-1]
    assert 2 * position == pytest.approx(0.1, abs=1e-5) and 2 * force == pytest.approx(5.0, rel=1e-3)
    position, force = stepped(spring, 200.0, 0.005, 4000)[-1]
    assert force == pytest.approx(50 * (0.1 - 2 * position) + 1.0, rel=1e-6)


def test_the_actuator_gives_no_more_than_its_range_with_it():
    limited = build(SERVO.replace("{}", 'forcerange="-2 2"'))
    force = stepped(limited, 200.0, 0.1, 400, start=-1.0)[:, 1]
    assert force.max() == 2.0


@pytest.mark.parametrize("effect_of", [("servo-integral", "servo"), ("compliance", "x+motor")], ids="@".join)
def test_a_gear_that_is_open_is_the_effect_s_own_as_well(effect_of):
    """A model whose gear a parameter has changed is the one with that gear, simulated and in a plain loop."""
    (name, site), shown = effect_of, '<actuatorpos name="motor" actuator="servo"/></sensor>'
    xml = SERVO.replace("{}", "").replace("</sensor>", shown)
    believed, true = build(xml.replace('gear="2"', 'gear="1"')), build(xml)
    cls = effects.REGISTRY.get(name)
    effect, tape = cls(believed, site), waves(believed, 0.4)
    values = away(cls(true, site), 0.2)
    fields = ModelFields(believed, 1)
    fields["actuator_gear"][:, 0, 0] = 2.0
    start = InitialStates(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 0)), np.zeros(1))
    simulated = [
        Engine(m, 1)
        .rollout(
            initial=start,
            controls=tape[None, :, None],
            fields=f,
            forces=[e.force(values[None], 0.001)],
        )
        .sensors[0]
        for m, f, e in ((believed, fields, effect), (true, None, cls(true, site)))
    ]
    np.testing.assert_allclose(*simulated, atol=1e-12)
    module = {}
    exec(companion_module("model.xml", "task", {f"{name}@{site}": (effect, values)}), module)
    alone = looped(true, mujoco.MjData(true), module["Effects"](true), tape[:, None])
    np.testing.assert_allclose(alone, simulated[1], atol=1e-9)


def test_a_window_begins_with_what_an_open_gear_made_of_the_errors():
    model = build(SERVO.replace("{}", "").replace('gear="2"', 'gear="1"'))
    effect = effects.REGISTRY.get("servo-integral")(model, "servo")
    tape, gear = waves(model, 2.0), {"actuator_gear": np.eye(6)[:1] * 2.0}
    log, begun = begun_inside(effect, np.array([300.0, 0.002]), tape, [700, 1500], fields=gear)
    np.testing.assert_allclose(begun, log, atol=1e-9)


@pytest.mark.parametrize("flag", ["enable", "disable"])
def test_its_set_point_is_clamped_where_that_of_the_servo_is(flag):
    """Set points of 0.1 m over a range of 0.05 m: the position, by the gear, comes to what the servo makes of them."""
    option = f'gravity="0 0 0"><flag clampctrl="{flag}"/></option>'
    xml = SERVO.replace('gravity="0 0 0"/>', option).replace("{}", 'ctrlrange="-.05 .05"')
    model = build(xml)
    reached = 0.05 if flag == "enable" else 0.1
    assert 2 * stepped(model, 200.0, 0.1, 4000)[-1, 0] == pytest.approx(reached, abs=1e-4)
    effect, values = effects.REGISTRY.get("servo-integral")(model, "servo"), np.array([50.0, 0.1])
    tape = waves(model, 2.0, 0.2)
    log, begun = begun_inside(effect, values, tape, [700, 1500])
    np.testing.assert_allclose(begun, log, atol=1e-9)
    module = {}
    exec(companion_module("model.xml", "task", {"servo-integral@servo": (effect, values)}), module)
    alone = looped(model, mujoco.MjData(model), module["Effects"](model), tape[:800, None])
    np.testing.assert_allclose(alone[700:, 0], log[0], atol=1e-9)


@pytest.mark.parametrize("steps", [1, 7, 50])
def test_a_constant_error_is_integrated_exactly_whatever_the_step(steps):
    term = IntegralTerm(ki=np.array([3.0]), limit=np.array([0.4]), timestep=1 / steps, integral=0.1)
    given = [term(0.5, np.array([0.3])) for _ in range(steps)]
    assert np.mean(given) == pytest.approx(3.0 * (0.1 + 0.2 / 2))
    assert term.integral == pytest.approx(0.1 + 0.2)
    for _ in range(steps):
        term(0.5, np.array([0.3]))
    assert term.integral == 0.4


def waves(model: mujoco.MjModel, seconds: float, size: float = 0.1) -> np.ndarray:
    """Set points (step,) of two periods that do not fit."""
    time = np.arange(0, seconds, model.opt.timestep)
    return size * (np.sin(5 * time) + np.sin(13 * time + 1)) / 2


@pytest.mark.parametrize("late", [0, 7], ids=["in time", "late"])
@pytest.mark.parametrize("limit", [0.002, 0.5], ids=["clamped", "unlimited"])
def test_a_simulation_that_begins_inside_a_log_goes_on_as_the_log_did(limit, late):
    model = build(SERVO.replace("{}", ""))
    effect = effects.REGISTRY.get("servo-integral")(model, "servo")
    log, begun = begun_inside(
        effect, np.array([300.0, limit]), waves(model, 3.0), [0, 700, 1500, 2600], late=late
    )
    np.testing.assert_allclose(begun, log, atol=1e-9)


@pytest.mark.parametrize("ki", [30.0, 200.0])
def test_what_held_a_load_when_the_log_began_is_no_farther_than_one(ki):
    spring = build(SERVO.replace('damping="20"', 'damping="20" stiffness="100"').replace("{}", ""))
    effect = effects.REGISTRY.get("servo-integral")(spring, "servo")
    tape, values = 0.1 + waves(spring, 5.0, 0.001), np.array([ki, 0.1])
    log, begun = begun_inside(
        effect, values, tape, [4000, 4000], stretches=[slice(4000, 5000)], states=np.array([[0.0], [0.1]])
    )
    way = (begun[1] - begun[0]) / 0.1
    state = way @ (log[0] - begun[0]) / (way @ way)  # what the machine does is linear in it
    assert 0.01 < state < 1
    np.testing.assert_allclose(begun[0] + way * state, log[0], atol=1e-6)
    assert effect.space.high[1] > 2.5 / ki  # the force of the actuator that the spring takes, over ki
