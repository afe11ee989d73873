"""What a simulated machine has beside its model: `--estimate` and `--effect` of record, gen-histories, train-policy."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reaching import Reaching
from setting_numbers import set_numbers

from capture_cli.context.checkpoints.policy_checkpoint import load_policy
from capture_cli.errors import OptionError
from capture_cli.log.arrays import Log
from capture_cli.log.windows import cut
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.placed import Placed
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.air_hockey import AirHockey
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages import identify as identify_stage
from capture_cli.stages import simulated_machine
from capture_cli.stages import train_policy as train_policy_stage
from capture_cli.stages.diagnose import diagnose
from capture_cli.stages.effect_option import parse_effects
from capture_cli.stages.export import export
from capture_cli.stages.gen_histories import gen_histories
from capture_cli.stages.identify import identify
from capture_cli.stages.record import record
from capture_cli.stages.train_policy import train_policy
from capture_cli.stages.train_sysid import train_sysid
from capture_cli.store.diagnosis import Diagnosis
from capture_cli.store.estimate import Estimate
from capture_cli.store.histories import Histories
from capture_cli.store.provenance import write_json

pytestmark = pytest.mark.usefixtures("without_pages")

TAPES = {"points": 5, "window": 0.1, "amplitude": {"drive": 3.0}}
SMALL = {"pairs": 24, "rounds": 4, "shard_pairs": 16, "threads": 1, **TAPES}
FRICTION = "coulomb-friction@x"
# of each place, and of control and measurement what reaches beyond a window
ADDED = (
    "coulomb-friction@puck_x=0.01",
    "coulomb-friction@mallet_x=0.01",
    "control-second-order-lag@mallet_vx.time_constant=0.1",
    "control-delay@mallet_vy=0.05",
    "sensor-delay@puck_x=0.04",
    "sensor-clock-rate=0.02",
    "sensor-clock-rate=-0.02",
    "sensor-scale@puck_y=0.1",
)


def placed(text: str, task):
    """The effect of `text` in the task's model, with its values."""
    [added] = parse_effects([text], task.model).at_middle
    return added


@pytest.fixture(scope="module")
def strokes():
    """Actions and parameters of the plant of air hockey."""
    task, generator = AirHockey(), np.random.default_rng(0)
    return task, task.draw_actions(generator.random((4, 4))), task.space.from_unit(generator.random((4, 5)))


# --- in the simulator ---


@pytest.mark.parametrize("text", ADDED)
def test_an_episode_of_an_action_is_what_a_log_of_it_would_show(text, strokes):
    """Trajectories read a simulation at their points, and a log, which begins alike, at any time."""
    task, actions, parameters = strokes
    effect, values = placed(text, task)
    simulator = Simulator(task, [effect], threads=1)
    points = np.concatenate([parameters, np.repeat(values[None], 4, axis=0)], axis=1)
    trajectories, diverged = simulator.trajectories(points, actions)
    assert not diverged.any()
    without, _ = Simulator(task, threads=1).trajectories(parameters, actions)
    assert np.abs(trajectories - without).max() > 1e-6
    episodes = task.episodes(actions)
    steps = episodes.inputs.shape[1]
    time = np.tile(task.timestep * np.arange(steps), 4)
    samples = Log(
        time,
        np.zeros((4 * steps, 4)),
        [slice(k * steps, (k + 1) * steps) for k in range(4)],
        episodes.inputs.reshape(4 * steps, -1),
    )
    windows = cut(samples, None, task.timestep, task.holds, has_gaps=False)
    at = np.rint(task.point_times / task.timestep).astype(int)
    for k in range(4):
        logged = simulator.simulate(
            windows.rows(np.array([k])), episodes.initial.rows(np.array([k])), points[k]
        )
        assert np.abs(task.observe(logged.outputs[0, 0][at]) - trajectories[k]).max() < 1e-9


@pytest.mark.parametrize("text", ADDED)
def test_known_values_are_those_of_a_candidate(text, strokes):
    task, actions, parameters = strokes
    effect, values = added = placed(text, task)
    mended, simulator = Simulator(task.with_effects([added]), threads=1), Simulator(task, [effect], threads=1)
    assert mended.space.names == task.space.names and not task.effects
    assert mended.hidden_states == simulator.hidden_states
    points = np.concatenate([parameters, np.repeat(values[None], 4, axis=0)], axis=1)
    assert np.array_equal(
        mended.trajectories(parameters, actions)[0], simulator.trajectories(points, actions)[0]
    )


def test_a_known_effect_acts_before_one_that_is_looked_for(slider_task):
    task = load_task(str(slider_task))
    friction, drag = (
        Placed(n, REGISTRY.get(n)(task.model, "x")) for n in ("coulomb-friction", "quadratic-drag")
    )
    both = Simulator(task, [friction, drag], threads=1)
    one = Simulator(task.with_effects([(friction, np.array([2.0]))]), [drag], threads=1)
    log = record(
        task=str(slider_task), out=slider_task.with_name("l.zarr"), amplitude={"drive": 5.0}, threads=1
    ).log
    windows = cut(log.arrays, None, task.timestep, task.holds, has_gaps=False)
    rest = InitialStates(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 0)), np.zeros(1))
    given = both.simulate(windows, rest, np.array([2.0, 1.0, 2.0, 0.5]))
    known = one.simulate(windows, rest, np.array([2.0, 1.0, 0.5]))
    assert np.array_equal(given.outputs, known.outputs)
    assert one.space.names == ("mass", "damping", "quadratic-drag@x.drag")


# --- what is asked for ---


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"{FRICTION}=2:2", "nothing lies between 2 and 2"),
        (f"{FRICTION}=3:1", "nothing lies between 3 and 1"),
        (f"{FRICTION}=1:", "'' is not a finite number"),
        (f"{FRICTION}=1:2:3", "'2:3' is not a finite number"),
        (f"{FRICTION}=nan:3", "'nan' is not a finite number"),
        ("coulomb-friction@y=1:2", "'y' is not a site"),
        ("no-such-effect=1", "unknown effect"),
        ("tendon-friction=1", "the model has no place for it"),
        ("reflected-inertia@x=-2:1", "cannot be negative"),
    ],
)
@pytest.mark.parametrize("command", ["record", "gen-histories"])
def test_an_effect_that_cannot_be_is_refused_before_any_work(
    capture, slider_task, tmp_path, command, text, said
):
    before = sorted(tmp_path.iterdir())
    code, _, err = capture(command, "--task", slider_task, "--effect", text, "--out", "new.zarr")
    assert code == 2 and said in err and "cure" in err
    assert sorted(tmp_path.iterdir()) == before


def test_an_effect_by_name_alone_goes_over_its_range_where_one_learns(slider_task):
    model = load_task(str(slider_task)).model
    with pytest.raises(OptionError, match="gives friction no value"):
        parse_effects([FRICTION], model)
    found = parse_effects([FRICTION], model, over_own_range=True)
    [(_, effect)] = found.placed
    assert (found.low, found.high) == (effect.space.low, effect.space.high) and found.vary


def test_an_effect_goes_before_what_was_found(slider_task):
    model = load_task(str(slider_task)).model
    names = ("coulomb-friction", "stribeck-friction")
    found = [(Placed(n, REGISTRY.get(n)(model, "x")), REGISTRY.get(n)(model, "x").space.high) for n in names]
    both = parse_effects([f"{FRICTION}=1:2", "quadratic-drag@x=0.3"], model, found=found)
    assert [p.name for p in both.placed] == [FRICTION, "stribeck-friction@x", "quadratic-drag@x"]
    assert (both.low[0], both.high[0]) == (1.0, 2.0)
    assert np.array_equal(both.low[1:-1], found[1][1]) and both.low[-1] == both.high[-1] == 0.3
    assert found[0][1] == REGISTRY.get("coulomb-friction")(model, "x").space.high  # is left alone


# --- record ---


def test_a_value_between_two_is_drawn_by_the_seed(slider_task, tmp_path):
    def truth(name: str, **options) -> dict:
        made = record(
            task=str(slider_task),
            out=tmp_path / name,
            effects=[f"{FRICTION}=1:2"],
            amplitude={"drive": 5.0},
            duration=0.5,
            threads=1,
            **options,
        )
        return made.truth["effects"]

    first, again, other = truth("a.zarr"), truth("b.zarr"), truth("c.zarr", seed=1)
    assert first == again != other
    assert all(1 < t[f"{FRICTION}.friction"] < 2 for t in (first, other))
    options = json.loads((tmp_path / "a.zarr" / "provenance.json").read_text())["options"]
    assert not {"effects", "parameters", "estimate"} & set(options)


def diagnosis(folder: Path, task: Path, effects: list[dict], name: str = "slider") -> Path:
    """A diagnosis directory as far as it is read of: mass 2, damping 1, and these effects."""
    folder.mkdir()
    log = task.with_name("run.zarr")
    values = {"mass": 2.0, "damping": 1.0}
    parameters = {n: {"value": v, "unit": "kg", "low": 0.0, "high": 8.0} for n, v in values.items()}
    document = {
        "format": "capture/diagnosis",
        "version": Diagnosis.KIND.version,
        "task": name,
        "log": {"path": str(log), "sha256": "", "first_time": 0.0},
        "verdict": "effect-found",
        "summary": "found",
        "parameters": parameters,
        "effects": effects,
        "expression": None,
    }
    made = {"command": "diagnose", "options": {"task": str(task)}, "inputs": {}}
    write_json(folder / "provenance.json", {"format": "capture/provenance", "version": 1, **made})
    write_json(folder / "diagnosis.json", document)
    return folder


def friction(value: float) -> list[dict]:
    parameters = {"friction": {"value": value, "unit": "N", "low": 0.0, "high": 9.0}}
    return [{"name": "coulomb-friction", "site": "x", "parameters": parameters}]


@pytest.fixture
def found(slider_task, tmp_path, monkeypatch):
    """A diagnosis of the slider that found a friction; what else of its file is read elsewhere is not asked for."""
    monkeypatch.setattr(Diagnosis, "KIND", replace(Diagnosis.KIND, shape={}))
    monkeypatch.setattr(
        Diagnosis, "read", classmethod(lambda kind, folder: kind(kind.read_document(folder), {}, {}))
    )
    return diagnosis(tmp_path / "found", slider_task, friction(1.5))


def test_a_machine_has_the_values_and_effects_of_a_diagnosis(found, slider_task, tmp_path):
    def made(**options) -> dict:
        return record(
            task=str(slider_task),
            out=tmp_path / "log.zarr",
            estimate=found,
            amplitude={"drive": 5.0},
            duration=0.5,
            threads=1,
            force=True,
            **options,
        ).truth

    known = made()
    assert known["parameters"] == {"mass": 2.0, "damping": 1.0}
    assert known["effects"] == {f"{FRICTION}.friction": 1.5}
    assert made(parameters={"mass": 3.0})["parameters"] == {"mass": 3.0, "damping": 1.0}
    drawn = made(random_parameters=True, effects=[f"{FRICTION}=0.5"])
    assert drawn["parameters"]["mass"] not in (1.5, 2.0) and drawn["effects"] == {f"{FRICTION}.friction": 0.5}
    provenance = (tmp_path / "log.zarr" / "provenance.json").read_text()
    assert "found" not in provenance  # whoever reads a log must not find its truth


# --- histories ---


def generated(task: Path, out: Path, **options) -> tuple[dict, dict]:
    gen_histories(task=str(task), out=out, **{**SMALL, **options})
    histories = Histories(out)
    return histories.read(0, len(histories)), histories.attributes


def test_histories_of_a_machine_with_an_effect_have_it_on_both_sides(found, slider_task, tmp_path):
    by_name, about = generated(slider_task, tmp_path / "a.zarr", effects=[f"{FRICTION}=1.5"])
    by_estimate, same = generated(slider_task, tmp_path / "b.zarr", estimate=found)
    plain, none = generated(slider_task, tmp_path / "c.zarr")
    assert all(np.array_equal(by_name[n], by_estimate[n]) for n in by_name)
    assert about["effects"] == same["effects"] and none["effects"] == []
    [row] = about["effects"]
    assert (row["name"], row["site"]) == ("coulomb-friction", "x")
    assert row["parameters"]["friction"]["value"] == 1.5
    assert row["parameters"]["friction"]["drawn"] == [1.5, 1.5]
    for name in ("parameters", "actions", "target"):
        assert np.array_equal(plain[name], by_name[name])
    for side in ("simulated", "measured"):
        assert np.abs(plain[side] - by_name[side]).max() > 1e-4
    assert np.array_equal(by_name["simulated"][:, -1], by_name["measured"][:, -1])
    made = json.loads((tmp_path / "b.zarr" / "provenance.json").read_text())
    assert made["options"]["estimate"] == str(found) and made["inputs"]["estimate"]["path"] == str(found)
    made = json.loads((tmp_path / "a.zarr" / "provenance.json").read_text())
    assert made["options"]["effects"] == [f"{FRICTION}=1.5"]


def test_an_effect_with_a_range_is_a_nuisance_of_the_measured_side(slider_task, tmp_path):
    """Simulated in the middle of its range, measured anywhere in it, alike in all rounds of a pair."""
    ranged = {"effects": ["sensor-scale@q=-0.2:0.1"]}
    drawn, about = generated(slider_task, tmp_path / "r.zarr", **ranged)
    middle, _ = generated(slider_task, tmp_path / "m.zarr", effects=["sensor-scale@q=-0.05"])
    plain, _ = generated(slider_task, tmp_path / "p.zarr")
    assert about["effects"][0]["parameters"]["change"]["drawn"] == [-0.2, 0.1]
    assert np.array_equal(drawn["simulated"], middle["simulated"])
    large = np.abs(plain["measured"]) > 1e-3
    change = np.divide(drawn["measured"], plain["measured"], out=np.ones(large.shape), where=large) - 1
    of_pair = [change[k][large[k]] for k in range(24)]
    assert max(np.ptp(own) for own in of_pair) < 1e-4
    values = np.array([own.mean() for own in of_pair])
    assert -0.2 <= values.min() < -0.15 and 0.05 < values.max() <= 0.1
    again, _ = generated(slider_task, tmp_path / "t.zarr", **{**ranged, "threads": 2})
    assert all(np.array_equal(again[n], drawn[n]) for n in again)


def test_histories_go_on_with_the_effects_they_were_begun_with(slider_task, tmp_path):
    out = tmp_path / "h.zarr"
    generated(slider_task, out, effects=[f"{FRICTION}=1:3"])
    with pytest.raises(OptionError, match=r"effects\[0\].* was"):
        generated(slider_task, out, effects=[f"{FRICTION}=1:2"], resume=True)
    generated(slider_task, out, effects=[f"{FRICTION}=1:3"], resume=True)


def test_histories_of_the_version_before_have_no_effects(slider_task, tmp_path):
    plain, _ = generated(slider_task, tmp_path / "h.zarr")
    root = tmp_path / "h.zarr" / "zarr.json"
    document = json.loads(root.read_text())
    assert document["attributes"]["version"] == 2
    del document["attributes"]["effects"]
    document["attributes"]["version"] = 1
    root.write_text(json.dumps(document))
    histories = Histories(tmp_path / "h.zarr")
    assert histories.attributes["effects"] == []
    assert np.array_equal(histories.read(0, 24)["measured"], plain["measured"])


# --- an estimate that cannot be meant ---


@pytest.mark.parametrize("command", ["record", "gen-histories", "train-policy"])
def test_an_estimate_of_another_task_is_refused(capture, found, tmp_path, command, learn):
    before = sorted(tmp_path.iterdir())
    code, _, err = capture(command, "--task", "scooping", "--estimate", found, "--out", "new.zarr")
    assert code == 2 and "belongs to the task 'slider', and --task is 'scooping'" in err
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("command", ["gen-histories", "train-policy"])
def test_values_alone_mean_nothing_to_what_goes_over_all(
    capture, found, slider_task, tmp_path, command, learn
):
    document = json.loads((found / "diagnosis.json").read_text())
    write_json(found / "diagnosis.json", {**document, "effects": []})
    code, _, err = capture(command, "--task", slider_task, "--estimate", found, "--out", "new.zarr")
    assert code == 2 and "has no effects" in err and "capture diagnose" in err
    assert not (tmp_path / "new.zarr").exists()


def test_a_world_lacks_nothing_that_could_be_added(capture, found, tmp_path, monkeypatch):
    monkeypatch.setattr("capture_cli.context.worlds.world.require", lambda *_: None)
    effect = "control-delay@mallet_vx=0.05"
    code, _, err = capture(
        *("record", "--task", "air-hockey", "--world", "robosuite", "--effect", effect, "--out", "new.zarr")
    )
    assert code == 2 and "--effect means nothing" in err and "(control-delay@mallet_vx)" in err
    assert not (tmp_path / "new.zarr").exists()


# --- a learned identifier that knows the effect ---


def test_identify_has_the_effect_that_its_identifier_learned_with(slider_task, tmp_path, learn):
    """A log with a friction is not explained by the declared model, and by the mended one it is."""

    drive = {"amplitude": {"drive": 6.0}, "band": (0.5, 4.0)}
    truth = {"mass": 2.2, "damping": 3.0}
    log = tmp_path / "log.zarr"
    record(
        task=str(slider_task),
        out=log,
        parameters=truth,
        effects=[f"{FRICTION}=1.5"],
        episodes=3,
        duration=2.0,
        rate=250,
        noise=2e-4,
        threads=1,
        **drive,
    )
    histories = tmp_path / "mended.zarr"
    gen_histories(
        task=str(slider_task),
        out=histories,
        effects=[f"{FRICTION}=1.5"],
        inputs_from=log,
        pairs=32,
        points=6,
        threads=1,
    )
    sizes = {"width": 16, "layers": 1, "heads": 2, "steps": 5, "batch": 32}
    train_sysid(histories=histories, out=tmp_path / "mended", **sizes)
    estimates = {}
    for name, identifier in (("declared", "least-squares"), ("mended", str(tmp_path / "mended"))):
        estimates[name] = identify(
            real_log=log,
            task=str(slider_task),
            identifier=identifier,
            out=tmp_path / f"{name}.estimate",
            test="none",
            starts=1,
            threads=1,
            quiet=True,
        ).document
    assert estimates["declared"]["verdict"] == "unexplained" and estimates["declared"]["effects"] == []
    mended = estimates["mended"]
    assert mended["verdict"] == "explained"
    for name, value in truth.items():
        assert abs(mended["parameters"][name]["value"] - value) < 4 * mended["parameters"][name]["sd"] + 1e-3
    assert mended["effects"][0]["parameters"]["friction"]["value"] == 1.5
    assert f"The model has {FRICTION}" in mended["in_context"]["text"]
    # what reads the estimate has the effect as well
    written = export(result=tmp_path / "mended.estimate", out=tmp_path / "m.xml").model
    assert 'frictionloss="1.5"' in written.read_text()
    again = record(
        task=str(slider_task),
        estimate=tmp_path / "mended.estimate",
        out=tmp_path / "again.zarr",
        **drive,
        threads=1,
    ).truth
    assert again["effects"] == {f"{FRICTION}.friction": 1.5}
    with pytest.raises(OptionError, match=f"was fitted with {FRICTION} in the model"):
        diagnose(
            real_log=log, estimate=tmp_path / "mended.estimate", out=tmp_path / "d", threads=1, quiet=True
        )


@pytest.mark.parametrize("noise", ["quiet", "as-the-residual"])
def test_windows_begin_with_what_a_known_effect_hides(noise, slider_task, tmp_path, monkeypatch):
    """The lag of a control hides a state, which no sensor shows; also where a fit is made anew with another noise."""
    lag, log = "control-second-order-lag@drive.time_constant=0.05", tmp_path / "log.zarr"
    truth = {"mass": 2.2, "damping": 3.0}
    made = {"amplitude": {"drive": 6.0}, "band": (0.5, 4.0), "duration": 2.0, "rate": 250, "episodes": 2}
    record(task=str(slider_task), out=log, parameters=truth, effects=[lag], noise=2e-4, threads=1, **made)
    known = placed(lag, load_task(str(slider_task)))
    read = identify_stage.find_task
    monkeypatch.setattr(identify_stage, "find_task", lambda *given: read(*given).with_effects([known]))
    if noise == "as-the-residual":
        look, before = identify_stage.with_noise_of_residual, []

        def louder_once(prepared, *given):
            before.append(prepared)
            return replace(look(prepared, *given)) if len(before) == 1 else prepared

        monkeypatch.setattr(identify_stage, "with_noise_of_residual", louder_once)
    estimate = identify(
        real_log=log, task=str(slider_task), out=tmp_path / "e", window=0.5, starts=1, threads=1, quiet=True
    )
    assert estimate.document["verdict"] == "explained"
    for name, value in truth.items():
        found = estimate.document["parameters"][name]
        assert abs(found["value"] - value) < 4 * found["sd"] + 1e-3
    # of the model's position and velocity
    assert estimate.arrays["window/start_offset"].shape[1] == 2


def test_an_estimate_of_the_version_before_has_no_effects(slider_task, tmp_path):
    log = tmp_path / "log.zarr"
    record(task=str(slider_task), out=log, amplitude={"drive": 5.0}, duration=1.0, noise=1e-4, threads=1)
    identify(real_log=log, task=str(slider_task), out=tmp_path / "e", starts=1, threads=1, quiet=True)
    document = json.loads((tmp_path / "e" / "estimate.json").read_text())
    assert document.pop("effects") == [] and document["version"] == 2
    write_json(tmp_path / "e" / "estimate.json", {**document, "version": 1})
    assert Estimate.read(tmp_path / "e").document["effects"] == []


# --- policies ---


@pytest.fixture
def reaching(monkeypatch):
    monkeypatch.setattr(simulated_machine, "load_task", lambda name: Reaching())


POLICY = {"task": "reaching", "steps": 1200, "envs": 50, "evaluations": 3, "width": 16, "batch": 64}
POLICY |= {"updates": 25, "learning_rate": 5e-3, "threads": 1}


def test_a_policy_is_trained_and_judged_in_the_machine_with_the_effect(reaching, tmp_path, learn):
    """Against a friction of 0.5 N it has to push harder than the plain task's policy does."""

    known = train_policy(out=tmp_path / "known", effects=[f"{FRICTION}=0.5"], **POLICY)
    plain = train_policy(out=tmp_path / "plain", **POLICY)
    assert known["effects"][0]["parameters"]["friction"]["drawn"] == [0.5, 0.5] and plain["effects"] == []
    assert min(known["result"]["success"], plain["result"]["success"]) > 0.7
    task, masses = Reaching(), np.linspace(0.6, 1.9, 20)[:, None]
    policies = {name: load_policy(str(tmp_path / name), task) for name in ("known", "plain")}
    actions = {name: policy.act(masses, np.zeros((20, 1))) for name, policy in policies.items()}
    assert (actions["known"] - actions["plain"]).mean() == pytest.approx(0.5, abs=0.2)
    made = json.loads((tmp_path / "known" / "provenance.json").read_text())
    assert made["options"]["effects"] == [f"{FRICTION}=0.5"]


def test_a_training_with_a_drawn_effect_goes_on_to_the_same_bytes(reaching, tmp_path, monkeypatch, learn):
    from capture_cli.context.policies._sac_training import SacTrainer

    options = {**POLICY, "steps": 400, "effects": [f"{FRICTION}=0.1:0.6"]}
    train_policy(out=tmp_path / "whole", **options)
    train, count = SacTrainer.train, iter(range(1000))

    def interrupted(self):
        if next(count) == 5:
            raise KeyboardInterrupt
        return train(self)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(SacTrainer, "train", interrupted)
        train_policy(out=tmp_path / "parts", **options)
    with pytest.raises(OptionError, match="the earlier run differs"):
        train_policy(out=tmp_path / "parts", **{**options, "effects": []}, resume=True)
    train_policy(out=tmp_path / "parts", **options, resume=True)
    for name in ("policy.json", "policy.safetensors", "metrics.jsonl"):
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "parts" / name).read_bytes()


@pytest.mark.parametrize(
    ("effect", "mirrored"), [("control-delay@mallet_vx=0.02", True), ("control-bias@mallet_vy=0.02", False)]
)
def test_half_of_the_actions_are_mirrored_only_where_the_machine_is_alike_there(
    tmp_path, monkeypatch, learn, effect, mirrored
):
    set_numbers(monkeypatch, train_policy_stage, held_out=16)
    set_numbers(monkeypatch, train_policy_stage, evaluated=16)
    sizes = {"steps": 64, "envs": 32, "evaluations": 1, "width": 8, "layers": 1, "batch": 16, "updates": 1}
    made = train_policy(task="air-hockey", out=tmp_path / "p", effects=[effect], threads=1, **sizes)
    assert made["settings"]["mirrored"] is mirrored
    policy = load_policy(str(tmp_path / "p"), AirHockey())
    parameters = AirHockey().space.nominal[None]
    sides = [policy.act(parameters, np.full((1, 4), u))[0] for u in (0.1, 0.9)]
    assert np.array_equal(*sides) is not mirrored
