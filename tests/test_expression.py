"""What `diagnose` ends with: a formula for a force that no effect of the catalogue explains."""

from __future__ import annotations

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from held_inputs import MACHINES, held_machine

from capture_cli.estimate.balance.recorded_world import RecordedWorld
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.model.effects._scales import characteristic_speed
from capture_cli.model.tasks import load_task
from capture_cli.select.expression import SETTINGS as EXPRESSION
from capture_cli.select.expression import expression_terms, formula
from capture_cli.select.search import attribution
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.diagnose import diagnose
from capture_cli.stages.record import record

CART_POLE = MACHINES / "cart_pole" / "task.toml"
STIFFNESS = 150.0  # N/m^3


@pytest.fixture
def simulators(monkeypatch) -> list[Simulator]:
    """Every simulator that is made from here on."""
    made, begin = [], Simulator.__init__

    def kept(simulator, *arguments, **options):
        begin(simulator, *arguments, **options)
        made.append(simulator)

    monkeypatch.setattr(Simulator, "__init__", kept)
    return made


@pytest.fixture
def diagnosed(tmp_path, monkeypatch, without_pages):
    """diagnosed(**options): of the slider with a cubic spring, by a catalogue that has no effect."""
    log, task = tmp_path / "log.zarr", str(held_machine(tmp_path / "slider", "slider", 0.004))
    record(
        task=task,
        out=log,
        effects=[f"cubic-stiffness@x={STIFFNESS}"],
        noise=5e-4,
        episodes=4,
        duration=1.5,
        rate=250,
        seed=1,
    )
    monkeypatch.setattr(attribution, "all_candidates", lambda _: [])

    def run(**options):
        out = tmp_path / "diagnosis"
        return diagnose(real_log=log, task=task, out=out, quiet=True, threads=1, starts=1, **options).document

    return run


def test_a_force_that_the_catalogue_lacks_is_written_as_a_formula(diagnosed, simulators):
    document = diagnosed()
    assert (document["verdict"], document["effects"]) == ("unexplained", [])
    found = document["expression"]
    (term,) = found["terms"]
    assert (term["site"], term["unit"]) == ("x: q^3", "N per m^3")
    assert term["coefficient"] == pytest.approx(-STIFFNESS, abs=4 * term["sd"])
    assert term["sd"] < 1.0
    assert found["text"] == f"missing force at x = {term['coefficient']:+.4g} q^3"
    assert document["before"]["test"]["normalized"] > 5
    assert found["select"]["normalized"] == pytest.approx(1, abs=0.1)
    assert found["test"]["normalized"] == pytest.approx(1, abs=0.1)
    assert document["rollouts"]["simulated"] == sum(s.rollouts for s in simulators)


def test_one_that_does_no_better_on_what_was_held_out_is_none(diagnosed, monkeypatch):
    on = ModelFits.on

    def worse(self, part, fit, *rest, **options):
        judged = on(self, part, fit, *rest, **options)
        is_test = part.split.is_test.any() and fit.effects
        return replace(judged, residual=20 * judged.residual) if is_test else judged

    monkeypatch.setattr(ModelFits, "on", worse)
    found = diagnosed()["expression"]
    assert (found["terms"], found["text"]) == ([], "no expression explains what is left")


def test_it_is_not_looked_for_where_nobody_wants_it(diagnosed, simulators):
    document = diagnosed(expression=False)
    assert (document["verdict"], document["expression"]) == ("unexplained", None)
    assert document["rollouts"]["simulated"] == sum(s.rollouts for s in simulators)


def test_every_joint_has_terms_of_its_own_and_of_the_others():
    task = load_task(str(CART_POLE))
    terms = [effect for _, effect in expression_terms(task.model, [c.index for c in task.inputs])]
    sites = [t.site for t in terms]
    assert len(set(sites)) == len(sites)
    joints = [task.model.joint(j).name for j in range(task.model.njnt)]
    for own, other in (joints, joints[::-1]):
        assert {f"{own}: q^3", f"{own}: v|v|", f"{own}: v v_{other}"} <= set(sites)


def test_terms_at_one_joint_are_no_places_of_one_law():
    task = load_task(str(CART_POLE))
    terms = expression_terms(task.model, [c.index for c in task.inputs])
    at = {}
    for term in terms:
        at.setdefault(term.effect.joint, []).append(term.law)
    assert all(len(set(laws)) == len(laws) for laws in at.values())
    first, second = at.values()
    assert {law for law in first if law in second} >= {("expression", "q"), ("expression", "v|v|")}


def test_the_formula_has_a_line_for_each_joint():
    task = load_task(str(CART_POLE))
    terms = {e.site: e for _, e in expression_terms(task.model, [])}
    first, second = (task.model.joint(j).name for j in range(2))
    chosen = [terms[f"{first}: q"], terms[f"{second}: q v"], terms[f"{first}: v|v|"]]
    expected = f"missing force at {first} = -1.5 q +2 v|v|; missing force at {second} = +0.25 q v"
    assert formula(chosen, np.array([-1.5, 0.25, 2.0])) == expected


def test_the_sign_of_a_velocity_reads_as_it_is_simulated():
    task = load_task(str(CART_POLE))
    u = task.inputs[0].name
    terms = [e for _, e in expression_terms(task.model, [c.index for c in task.inputs])]
    world = mujoco.MjData(task.model)
    world.qpos, world.qvel, world.ctrl = [-0.3, 0.4], [0.01, -0.02], [-2.0]
    for joint, (q, v) in enumerate(zip(world.qpos, world.qvel, strict=True)):
        signs = [t.term for t in terms if t.joint == joint and "tanh" in t.term.text]
        width = re.search(r"tanh\(v/([\d.e+-]+)\)", signs[0].text)
        assert float(width[1]) == pytest.approx(
            EXPRESSION.rest * characteristic_speed(task.model, joint), rel=0.05
        )
        value = np.tanh(v / float(width[1]))
        simulated = {t.text: eval(t.of("world", ""), {"np": np, "world": world}) for t in signs}
        assert simulated == {
            width[0]: value,
            f"|q| {width[0]}": abs(q) * value,
            f"|{u}| {width[0]}": 2.0 * value,
        }


class InOnePiece(np.ndarray):
    """Refuses to be worked with where its values do not follow one another."""

    def __array_ufunc__(self, ufunc, method, *inputs, **options):
        assert all(x.flags.c_contiguous for x in inputs if isinstance(x, np.ndarray))
        return getattr(ufunc, method)(*(np.asarray(x) for x in inputs), **options)


def test_terms_do_not_depend_on_where_the_memory_lies():
    """numpy's powers and sines of a strided array have another last digit where the result lies at its end."""
    task = load_task(str(CART_POLE))
    recorded = {name: np.ones((1, task.model.nv)).view(InOnePiece) for name in ("qpos", "qvel", "ctrl")}
    recorded["time"] = np.full(1, 0.5)
    world = RecordedWorld(task.model, recorded.get, np.zeros((3, 1), dtype=int))
    with pytest.raises(AssertionError):
        np.sin(world.qpos[:, 0])
    for placed in expression_terms(task.model, range(task.model.nu)):
        placed.effect.force(np.ones((3, 1)), task.timestep)(world)
    assert np.isfinite(world.qfrc_applied).all()
