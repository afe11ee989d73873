"""What `capture export` makes of a diagnosis runs without `capture`, and gives the same trajectories."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from machines import MACHINES, NAMES, away, controls, machine, placed, start
from plain_loop import imported, looped

from capture_cli.errors import ModelError, OutputError, StoreError
from capture_cli.log.arrays import Log
from capture_cli.log.input_sequences import HELD
from capture_cli.log.windows import SETTINGS as WINDOWS
from capture_cli.log.windows import cut
from capture_cli.model import effects
from capture_cli.model.effects.base import Effect
from capture_cli.model.effects.companion import companion_module
from capture_cli.model.effects.placed import Placed
from capture_cli.model.tasks import load_task
from capture_cli.select.expression import expression_terms
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.effect_option import parse_effects
from capture_cli.stages.export import Exported, export
from capture_cli.store.diagnosis import FORMAT, VERSION, Diagnosis
from capture_cli.store.provenance import Provenance

# One parameter that a machine declares, and the value that was identified.
DECLARED = {
    "slider": ("joint:x:damping", 2.5),
    "cart_pole": ("body:cart:mass", 1.2),
    "arm": ("joint:elbow:damping", 0.15),
    "drone": ("joint:up:damping", 0.08),
    "puck": ("body:puck:mass", 0.12),
    "ball": ("option:density", 1.5),
}
EXACT = 1e-9
MOST_MACHINES = 3  # beyond which an effect is exported on every other one
loaded = cache(load_task)  # by every export, and here once


@pytest.fixture(scope="module")
def tasks(tmp_path_factory) -> dict[str, Path]:
    """The task.toml of every machine."""
    return {name: write_task(tmp_path_factory.mktemp(name), name) for name in MACHINES}


def write_task(folder: Path, name: str) -> Path:
    model = machine(name)
    (folder / "model.xml").write_text(MACHINES[name])
    target, value = DECLARED[name]
    lines = ["format = 1", f'name = "{name}"', 'model = "model.xml"', "[parameters.declared]"]
    lines += [f'set = "{target}"', "low = 0.0", f"high = {2 * value}", 'unit = "SI"']
    for k in range(model.nu):
        own = model.actuator(k).name
        lines += [f"[inputs.{own}]", f'column = "{own}"', 'unit = "SI"']
    for k in range(model.nsensor):
        own = model.sensor(k)
        columns = [f"{own.name}_{i}" for i in range(own.dim[0])]
        if own.name not in ("potential", "kinetic"):
            column = json.dumps(columns if len(columns) > 1 else columns[0])
            lines += [f"[outputs.{own.name}]", f"column = {column}", 'unit = "SI"']
    path = folder / "task.toml"
    path.write_text("\n".join(lines))
    return path


Found = dict[str, tuple[Effect, np.ndarray]]


@pytest.fixture(scope="module")
def records(tasks, tmp_path_factory) -> dict[str, Path]:
    """A diagnosis directory of every machine, in which nothing was found."""
    folder = tmp_path_factory.mktemp("records")
    return {name: diagnosis(folder / name, task, {}) for name, task in tasks.items()}


def diagnosis(folder: Path, task: Path, found: Found) -> Path:
    """A diagnosis directory in which `found`, {NAME@SITE: (effect, values)}, was found."""
    curves = {f"bin/{kind}": np.zeros((0, 0)) for kind in ("centre", "before", "after", "error")}
    steps = {f"step/{kind}": np.zeros((2, 1)) for kind in ("measured", "before", "after")}
    windows = {f"window/{kind}": np.zeros(1, dtype=int) for kind in ("episode", "first", "part")}
    at = {"step/window": np.zeros(2, dtype=int), "step/time": np.arange(2.0)}
    attributes = {"outputs": [], "recordings": [], "curves": []}
    folder.mkdir()
    Diagnosis(document(task, found), windows | at | steps | curves, attributes).write(folder)
    Provenance("diagnose", {"task": str(task)}, {"task": task}).write(folder)
    return folder


def document(task: Path, found: Found) -> dict:
    """Its diagnosis.json."""
    machine_ = loaded(str(task))

    def parameters(space, values):
        return {
            p.name: {"value": float(v), "unit": "SI", "low": p.low, "high": p.high}
            for p, v in zip(space, values, strict=True)
        }

    return {
        "format": FORMAT,
        "version": VERSION,
        "task": machine_.name,
        "verdict": "effect-found",
        "log": {"path": "log.zarr", "first_time": 1.7e9},
        "parameters": parameters(machine_.space, [DECLARED[machine_.name][1]]),
        "effects": [
            {
                "name": name.partition("@")[0],
                "site": effect.site,
                "parameters": parameters(effect.space, values),
            }
            for name, (effect, values) in found.items()
        ],
    }


def simulated(task: Path, found: Found) -> np.ndarray:
    """Outputs (step, output) by `capture` itself."""
    machine_ = loaded(str(task))
    tape = controls(machine_.model, 1)[0]
    time = 0.25 + machine_.timestep * np.arange(len(tape))
    samples = Log(time, np.zeros((len(tape), len(machine_.outputs))), [slice(0, len(tape))], tape)
    windows = cut(samples, None, machine_.timestep, [HELD] * len(machine_.inputs))
    simulator = Simulator(
        machine_, [(name.partition("@")[0], effect) for name, (effect, _) in found.items()], 1
    )
    point = np.concatenate([[DECLARED[machine_.name][1]], *(values for _, values in found.values())])
    return simulator.simulate(windows, start(machine_.model, 1), point[None]).outputs[0, 0]


def played(written: Exported, task: Path) -> np.ndarray:
    """Outputs (step, output) of what was exported, in a plain loop."""
    model = mujoco.MjModel.from_xml_path(str(written.model))
    data = mujoco.MjData(model)
    begin = start(model, 1)
    data.qpos[:], data.qvel[:], data.time = begin.qpos[0], begin.qvel[0], begin.time[0]
    machine_ = loaded(str(task))
    tape = controls(machine_.model, 1)[0]
    ahead = 1 + int(
        np.ceil(WINDOWS.most_drift * len(tape))
    )  # so much more is seen by sensors that look ahead
    tape = np.concatenate([tape, np.repeat(tape[-1:], ahead, axis=0)])
    substeps = round(machine_.timestep / model.opt.timestep)
    beside = imported(written.companion).Effects(model) if written.companion else None
    sensors = looped(model, data, beside, np.repeat(tape, substeps, axis=0))
    return sensors[::substeps][:-ahead, [c.index for c in machine_.outputs]]


def found_at(*names: str, where: str, part: float = 0.4) -> Found:
    """Effects on a machine, some way from null."""
    found = {}
    for name in names:
        stem, _, site = name.partition("@")
        effect = effects.REGISTRY.get(stem)(machine(where), site)
        found[name] = (effect, away(effect, part))
    return found


# ---- every effect of the catalogue ----


@pytest.mark.parametrize("name", NAMES)
def test_exported_it_gives_the_same_trajectory(name, tasks, records, tmp_path):
    first_sites = list({where: effect for where, effect in reversed(placed(name))}.items())
    if len(first_sites) > MOST_MACHINES:
        first_sites = first_sites[::2]
    for number, (where, built) in enumerate(first_sites):
        effect = type(built)(loaded(str(tasks[where])).model, built.site)  # no body of which is `simple`
        found = {Placed(name, effect).name: (effect, away(effect, 0.4))}
        (records[where] / "diagnosis.json").write_text(json.dumps(document(tasks[where], found)))
        written = export(result=records[where], out=tmp_path / f"{number}.xml")
        assert (written.companion is None) == (effect.place == "model")
        error = np.abs(played(written, tasks[where]) - simulated(tasks[where], found)).max()
        assert error < EXACT, (where, effect.site)


@pytest.mark.parametrize("where", MACHINES)
def test_all_effects_of_a_machine_fit_in_one_module(where, tmp_path):
    found = {
        Placed(name, effect).name: (effect, away(effect, 0.05))
        for name in NAMES
        for machine_, effect in placed(name)
        if machine_ == where and effect.place != "model"
    }
    path = tmp_path / "all_effects.py"
    path.write_text(companion_module("all.xml", where, found))
    model = mujoco.MjModel.from_xml_string(MACHINES[where])
    data, beside = mujoco.MjData(model), imported(path).Effects(model)
    for ctrl in controls(model, 1)[0][:3]:
        beside.step(model, data, ctrl)
    assert np.isfinite(beside.sense(model, data.sensordata[None])).all()
    assert all(name in path.read_text() for name in found)


# what an actuator takes is not in the model but in the log, which drove it further than the model's mass lets expect
UNLIMITED = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body><joint name="x" type="slide" axis="1 0 0" damping="2"/><geom type="sphere" size=".1" mass="1"/></body>
  </worldbody>
  <actuator>{}</actuator>
  <sensor><jointpos name="x" joint="x"/></sensor>
</mujoco>
"""
LIMITS = {
    "control-saturation": ('<motor name="drive" joint="x"/>', 100.0, 60.0),
    "actuator-force-limit": ('<velocity name="drive" joint="x" kv="20"/>', 10.0, 60.0),
}


@pytest.mark.parametrize("name", LIMITS)
@pytest.mark.parametrize("which", ["diagnosed", "given to record", "null"])
def test_a_limit_beyond_what_the_model_alone_lets_expect_is_exported(name, which, tmp_path):
    actuator, driven, limit = LIMITS[name]
    (tmp_path / "model.xml").write_text(UNLIMITED.format(actuator))
    task = tmp_path / "task.toml"
    task.write_text(
        'format = 1\nname = "slider"\nmodel = "model.xml"\n[parameters.declared]\nset = "joint:x:damping"\n'
        'low = 0.0\nhigh = 5.0\nunit = "N s/m"\n[inputs.drive]\ncolumn = "drive"\nunit = "N"\n'
        '[outputs.x]\ncolumn = "x"\nunit = "m"\n'
    )
    as_driven = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    as_driven.actuator_ctrllimited[0], as_driven.actuator_ctrlrange[0] = True, (-driven, driven)
    effect = effects.REGISTRY.get(name)(as_driven, "drive")
    [((_, here), given)] = parse_effects([f"{name}@drive={limit}"], loaded(str(task)).model).at_middle
    assert here.space.high[0] < limit < effect.space.high[0]
    found = {
        "diagnosed": (effect, np.array([limit])),
        "given to record": (here, given),
        "null": (effect, effect.space.nominal),
    }[which]
    written = export(result=diagnosis(tmp_path / "d", task, {f"{name}@drive": found}), out=tmp_path / "m.xml")
    model = mujoco.MjModel.from_xml_path(str(written.model))
    data = mujoco.MjData(model)
    beside = imported(written.companion).Effects(model) if written.companion else None
    data.ctrl[0] = 3 * driven
    beside.step(model, data, data.ctrl.copy()) if beside else mujoco.mj_step(model, data)
    asked_for = 3 * driven * model.actuator_gainprm[0, 0]
    assert data.actuator_force[0] == pytest.approx(asked_for if which == "null" else limit)


def test_several_effects_act_together(tasks, tmp_path):
    found = found_at(
        "coulomb-friction@x",
        "direction-dependent-viscous@x",
        "load-dependent-friction@x",
        "compliance@x",
        "control-gain@drive",
        "control-delay@drive",
        "sensor-bias@v",
        "sensor-low-pass@x",
        where="slider",
        part=0.1,
    )
    written = export(result=diagnosis(tmp_path / "d", tasks["slider"], found), out=tmp_path / "m.xml")
    assert written.effects == tuple(found)[1:], "coulomb-friction is in the model"
    assert np.abs(played(written, tasks["slider"]) - simulated(tasks["slider"], found)).max() < EXACT


@pytest.mark.parametrize("names", list(itertools.permutations(["sensor-delay@x", "sensor-own-clock@x"])))
def test_a_clock_that_runs_ahead_of_what_is_late_is_exact_to_the_end(names, tasks, tmp_path):
    """The simulation ended where both together are, and the clock went on in a straight line from there."""
    found = found_at(*names, where="slider", part=0.3)
    written = export(result=diagnosis(tmp_path / "d", tasks["slider"], found), out=tmp_path / "m.xml")
    assert np.abs(played(written, tasks["slider"]) - simulated(tasks["slider"], found)).max() < EXACT


@pytest.mark.parametrize(
    ("site", "names"),
    [
        ("eighth", ["sensor-delay@x"]),
        ("half", ["control-delay@drive", "sensor-low-pass@x", "sensor-drift@v"]),
        ("eighth", ["control-second-order-lag@drive", "compliance@x", "sensor-clock-rate"]),
        ("quarter", ["control-rate-limit@drive", "control-fade@drive", "load-dependent-friction@x"]),
        ("quarter", ["control-supply-sag", "control-lag@drive"]),
    ],
)
def test_beside_a_finer_step_controls_and_sensors_keep_to_their_own_grid(site, names, tasks, tmp_path):
    """Effects on them with a memory ran at the finer step: a late sensor was off by 2 % as a simulation began."""
    found = found_at(*names, f"finer-time-step@{site}", where="slider", part=0.3)
    written = export(result=diagnosis(tmp_path / "d", tasks["slider"], found), out=tmp_path / "m.xml")
    assert np.abs(played(written, tasks["slider"]) - simulated(tasks["slider"], found)).max() < EXACT


def test_the_files_say_that_the_model_steps_finer_than_its_controls_come(tasks, tmp_path):
    found = found_at("sensor-delay@x", "control-lag@drive", "finer-time-step@eighth", where="slider")
    written = export(result=diagnosis(tmp_path / "d", tasks["slider"], found), out=tmp_path / "m.xml")
    assert "the model steps 8 times in each step of the grid" in written.model.read_text().split("-->")[0]
    said = imported(written.companion).__doc__
    assert "The model steps 8 times" in said and "np.repeat(controls, 8, axis=0)" in said
    assert "np.array(recorded))[::8]" in said
    without = found_at("sensor-delay@x", where="slider")
    written = export(result=diagnosis(tmp_path / "n", tasks["slider"], without), out=tmp_path / "n.xml")
    assert "steps" not in written.model.read_text().split("-->")[0]
    assert "for ctrl in controls:" in written.companion.read_text()


# ---- the module ----


def test_the_module_needs_only_mujoco_and_numpy(tasks, tmp_path):
    found = found_at("backlash@x", "sensor-delay@x", where="slider")
    export(result=diagnosis(tmp_path / "d", tasks["slider"], found), out=tmp_path / "m.xml")
    program = (
        "import sys; before = set(sys.modules); import m_effects;"
        "print(sorted({n.partition('.')[0] for n in set(sys.modules) - before if 'capture' in n}));"
        "import mujoco; model = mujoco.MjModel.from_xml_path('m.xml'); data = mujoco.MjData(model);"
        "m_effects.Effects(model).step(model, data, [1.0]); print(data.time)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["[]", "0.002"]


def test_a_step_leaves_the_model_and_the_users_forces_as_they_are(tasks, tmp_path):
    found = found_at(
        "stribeck-friction@x", "constant-force@x", "direction-dependent-viscous@x", where="slider"
    )
    written = export(result=diagnosis(tmp_path / "d", tasks["slider"], found), out=tmp_path / "m.xml")
    model = mujoco.MjModel.from_xml_path(str(written.model))
    data = mujoco.MjData(model)
    data.qfrc_applied[0] = 0.7
    friction, damping = model.dof_frictionloss.copy(), model.dof_damping.copy()
    imported(written.companion).Effects(model).step(model, data, [0.0])
    assert data.qfrc_applied[0] == 0.7
    assert np.array_equal(model.dof_frictionloss, friction) and np.array_equal(model.dof_damping, damping)


def test_reset_forgets(tasks, tmp_path):
    found = found_at("compliance@x", "control-lag@drive", where="slider")
    written = export(result=diagnosis(tmp_path / "d", tasks["slider"], found), out=tmp_path / "m.xml")
    model = mujoco.MjModel.from_xml_path(str(written.model))
    data, beside = mujoco.MjData(model), imported(written.companion).Effects(model)
    runs = []
    for _ in range(2):
        mujoco.mj_resetData(model, data)
        beside.reset(model)
        for ctrl in controls(model, 1)[0][:50]:
            beside.step(model, data, ctrl)
        runs.append(data.qpos.copy())
    assert np.array_equal(*runs) and runs[0][0] != 0


def test_names_cannot_break_the_module(tmp_path):
    name = 'a"""b\\'
    spec = mujoco.MjSpec.from_string(MACHINES["slider"])
    spec.joints[0].name = spec.sensors[0].objname = spec.sensors[1].objname = name
    spec.actuators[0].target = name
    model = spec.compile()
    effect = effects.REGISTRY.get("cogging")(model, name)
    path = tmp_path / "m_effects.py"
    path.write_text(companion_module('m"""\n.xml', name, {f"cogging@{name}": (effect, away(effect, 0.3))}))
    data = mujoco.MjData(model)
    data.qpos[0] = 0.01  # where the cogging pulls
    imported(path).Effects(model).step(model, data, [0.0])
    assert data.qvel[0] != 0


# ---- files and errors ----


def test_the_header_says_what_is_where(tasks, tmp_path):
    found = found_at("coulomb-friction@x", "stribeck-friction@x", where="slider")
    written = export(result=diagnosis(tmp_path / "d", tasks["slider"], found), out=tmp_path / "m.xml")
    assert written.companion == tmp_path / "m_effects.py"
    header = written.model.read_text().split("-->")[0]
    assert "verdict: effect-found" in header and "declared = 2.5 SI" in header
    assert "time 0 was 1700000000.000000 s in the log" in header
    assert "coulomb-friction@x\n" in header and "stribeck-friction@x (in m_effects.py)" in header
    assert 'MjModel.from_xml_path("m.xml")' in written.companion.read_text()


def test_the_header_says_since_when_an_effect_counts_its_time(tasks, tmp_path):
    """Of several recordings, not the first."""
    found = found_at("coulomb-friction@x", "periodic-disturbance@x", where="slider")
    source, rows = diagnosis(tmp_path / "d", tasks["slider"], found), document(tasks["slider"], found)
    for row, time in zip(rows["effects"], (1.7e9, 1.7e9 + 86_400), strict=True):
        row["first_time"] = time
    (source / "diagnosis.json").write_text(json.dumps(rows))
    header = export(result=source, out=tmp_path / "m.xml").model.read_text().split("-->")[0]
    assert "time 0 was 1700086400.000000 s in the log" in header


def test_a_companion_that_is_not_needed_any_more_does_not_stay(tasks, tmp_path):
    with_one = diagnosis(tmp_path / "d", tasks["slider"], found_at("stribeck-friction@x", where="slider"))
    without = diagnosis(tmp_path / "n", tasks["slider"], found_at("coulomb-friction@x", where="slider"))
    companion = export(result=with_one, out=tmp_path / "m.xml").companion
    (tmp_path / "m.xml").unlink()
    with pytest.raises(OutputError, match=r"m_effects\.py exists already"):
        export(result=without, out=tmp_path / "m.xml")
    assert companion.exists() and not (tmp_path / "m.xml").exists()
    assert export(result=without, out=tmp_path / "m.xml", force=True).companion is None
    assert not companion.exists()
    companion.write_text("my_own = 1")
    export(result=without, out=tmp_path / "m.xml", force=True)
    assert companion.read_text() == "my_own = 1"


def with_formula(task: Path, found: Found, terms: dict[str, float], values: dict[str, float]) -> dict:
    """Its diagnosis.json, with a formula and the `values` that all else has with it."""
    rows = [{"site": site, "coefficient": value, "sd": 0.1, "unit": "SI"} for site, value in terms.items()]
    return document(task, found) | {"expression": {"text": "...", "terms": rows, "values": values}}


@pytest.mark.parametrize("where", ["slider", "cart_pole", "arm"])
def test_every_term_of_a_formula_gives_the_same_trajectory(where, tasks, tmp_path):
    machine_ = loaded(str(tasks[where]))
    terms = expression_terms(machine_.model, [c.index for c in machine_.inputs])
    found = {p.name: (p.effect, np.array([0.02 / p.effect.term.scale])) for p in terms}
    source = diagnosis(tmp_path / "d", tasks[where], {})
    declared = dict(zip(machine_.space.names, [DECLARED[machine_.name][1]], strict=True))
    sizes = {effect.site: float(value[0]) for effect, value in found.values()}
    (source / "diagnosis.json").write_text(json.dumps(with_formula(tasks[where], {}, sizes, declared)))
    written = export(result=source, out=tmp_path / "m.xml")
    alone = simulated(tasks[where], found)
    assert np.abs(played(written, tasks[where]) - alone).max() < EXACT
    assert np.abs(alone - simulated(tasks[where], {})).max() > 1e-4


def test_beside_a_formula_all_has_the_values_that_go_with_it(tasks, tmp_path):
    found = found_at("coulomb-friction@x", "cogging@x", where="slider")
    changed = {name: (effect, 0.5 * values) for name, (effect, values) in found.items()}
    values = {
        f"{name}.{p.name}": v
        for name, (effect, own) in changed.items()
        for p, v in zip(effect.parameters, own.tolist(), strict=True)
    }
    machine_ = loaded(str(tasks["slider"]))
    values[machine_.space.names[0]] = DECLARED[machine_.name][1]
    source = diagnosis(tmp_path / "d", tasks["slider"], found)
    (source / "diagnosis.json").write_text(
        json.dumps(with_formula(tasks["slider"], found, {"x: q^3": -30.0}, values))
    )
    written = export(result=source, out=tmp_path / "m.xml")
    [cubic] = [p for p in expression_terms(machine_.model, []) if p.effect.site == "x: q^3"]
    all_of_it = changed | {cubic.name: (cubic.effect, np.array([-30.0]))}
    assert np.abs(played(written, tasks["slider"]) - simulated(tasks["slider"], all_of_it)).max() < EXACT
    assert written.effects == ("cogging@x", "expression@x: q^3")


@pytest.mark.parametrize(
    ("expression", "why"),
    [
        ({"terms": [{"site": "x: q", "coefficient": 1.0}]}, "without the values that go with it"),
        ({"terms": [{"site": "y: q", "coefficient": 1.0}], "values": {}}, "'y: q', which the model has not"),
        ({"terms": [{"site": "x: q", "coefficient": 1e300}], "values": {}}, r"1e\+300 times 'x: q', outside"),
    ],
)
def test_a_formula_that_does_not_belong_to_the_model_is_refused(expression, why, tasks, tmp_path):
    source = diagnosis(tmp_path / "d", tasks["slider"], {})
    made = document(tasks["slider"], {})
    if "values" in expression:
        expression["values"] = {name: p["value"] for name, p in made["parameters"].items()}
    (source / "diagnosis.json").write_text(json.dumps(made | {"expression": expression}))
    with pytest.raises(StoreError, match=why):
        export(result=source, out=tmp_path / "m.xml")
    assert not (tmp_path / "m.xml").exists()


@pytest.mark.parametrize(
    ("value", "why"),
    [(None, "among the values that go with it none of declared"), (1e308, "outside of its bounds")],
)
def test_the_values_beside_a_formula_are_all_there_and_within_their_bounds(value, why, tasks, tmp_path):
    source = diagnosis(tmp_path / "d", tasks["slider"], {})
    values = {} if value is None else {"declared": value}
    made = with_formula(tasks["slider"], {}, {"x: q": 1.0}, values)
    (source / "diagnosis.json").write_text(json.dumps(made))
    with pytest.raises(StoreError, match=why):
        export(result=source, out=tmp_path / "m.xml")
    assert not (tmp_path / "m.xml").exists()


def test_a_value_that_no_task_allows_is_refused_whatever_bounds_stand_beside_it(tasks, tmp_path):
    source = diagnosis(tmp_path / "d", tasks["slider"], {})
    made = document(tasks["slider"], {})
    made["parameters"]["declared"] |= {"value": 1e308, "low": 0.0, "high": 1e308}
    (source / "diagnosis.json").write_text(json.dumps(made))
    with pytest.raises(StoreError, match=r"declared = 1e\+308, and the task lets it be 0 to 5"):
        export(result=source, out=tmp_path / "m.xml")


def test_an_effect_larger_than_any_quantity_is_refused(tasks, tmp_path):
    found = found_at("coulomb-friction@x", where="slider")
    source = diagnosis(tmp_path / "d", tasks["slider"], found)
    made = document(tasks["slider"], found)
    (friction,) = made["effects"][0]["parameters"].values()
    friction["value"] = 1e308
    (source / "diagnosis.json").write_text(json.dumps(made))
    with pytest.raises(StoreError, match=r"coulomb-friction@x\..* = 1e\+308, and no quantity is larger"):
        export(result=source, out=tmp_path / "m.xml")


@pytest.mark.parametrize("existing", ["m.xml", "m_effects.py"])
def test_nothing_is_written_where_either_file_exists(existing, tasks, tmp_path):
    source = diagnosis(tmp_path / "d", tasks["slider"], found_at("cogging@x", where="slider"))
    (tmp_path / existing).write_text("mine")
    before = sorted(p.name for p in tmp_path.iterdir())
    with pytest.raises(OutputError, match=f"{existing} exists already"):
        export(result=source, out=tmp_path / "m.xml")
    assert sorted(p.name for p in tmp_path.iterdir()) == before
    assert (tmp_path / existing).read_text() == "mine"


def test_force_replaces_the_model_and_the_module_of_an_earlier_export(tasks, tmp_path):
    source = diagnosis(tmp_path / "d", tasks["slider"], found_at("cogging@x", where="slider"))
    companion = export(result=source, out=tmp_path / "m.xml").companion
    (tmp_path / "m.xml").write_text("old")
    companion.write_text(companion.read_text() + "# old\n")
    export(result=source, out=tmp_path / "m.xml", force=True)
    assert (tmp_path / "m.xml").read_text() != "old" and "# old" not in companion.read_text()


@pytest.mark.parametrize("force", [False, True])
def test_a_module_of_the_users_own_is_never_replaced(force, tasks, tmp_path):
    source = diagnosis(tmp_path / "d", tasks["slider"], found_at("cogging@x", where="slider"))
    (tmp_path / "m.xml").write_text("old")
    (tmp_path / "m_effects.py").write_text("mine")
    before = sorted(p.name for p in tmp_path.iterdir())
    with pytest.raises(
        OutputError, match=r"m_effects\.py exists already and `capture export` did not"
    ) as caught:
        export(result=source, out=tmp_path / "m.xml", force=force)
    assert "another --out" in caught.value.cure and "--force" not in caught.value.cure
    assert (tmp_path / "m.xml").read_text() == "old" and (tmp_path / "m_effects.py").read_text() == "mine"
    assert sorted(p.name for p in tmp_path.iterdir()) == before


def test_an_effect_that_cannot_be_exported_is_named_and_nothing_is_written(tasks, tmp_path, monkeypatch):
    cls = effects.REGISTRY.get("cogging")
    monkeypatch.setattr(cls, "companion", Effect.companion)
    assert cls.exported_as() == ""
    source = diagnosis(
        tmp_path / "d", tasks["slider"], found_at("coulomb-friction@x", "cogging@x", where="slider")
    )
    with pytest.raises(ModelError, match="cogging@x acts on the force and cannot be exported"):
        export(result=source, out=tmp_path / "m.xml")
    assert [p.name for p in tmp_path.iterdir()] == ["d"]


def test_a_diagnosis_of_another_model_is_refused(tasks, tmp_path):
    found = found_at("cogging@x", where="slider")
    source = diagnosis(tmp_path / "d", tasks["slider"], found)
    changed = json.loads((source / "diagnosis.json").read_text())
    changed["effects"][0]["site"] = "rail"
    (source / "diagnosis.json").write_text(json.dumps(changed))
    with pytest.raises(ModelError, match="Cogging cannot sit at 'rail'"):
        export(result=source, out=tmp_path / "m.xml")
    changed["effects"][0] |= {"site": "x", "parameters": {"sine": {"value": 1.0, "high": 2.0}}}
    (source / "diagnosis.json").write_text(json.dumps(changed))
    with pytest.raises(StoreError, match=r"cogging@x has the parameters \(sine\)"):
        export(result=source, out=tmp_path / "m.xml")
    with pytest.raises(StoreError, match=r"neither estimate\.json nor diagnosis\.json"):
        export(result=tmp_path, out=tmp_path / "m.xml")


@pytest.mark.parametrize(
    ("changed", "fault"),
    [
        ({"effects": [{"name": "cogging"}]}, r"effects\[0\]\.site, effects\[0\]\.parameters missing"),
        ({"parameters": {"mass": {"value": "2"}}}, "parameters.mass.value is '2'; expected a number"),
        ({"expression": {"terms": [{"site": "x: v", "coefficient": None}]}}, "coefficient is None; expected"),
    ],
)
def test_a_diagnosis_that_is_mistyped_is_refused(changed, fault, tasks, tmp_path):
    source = diagnosis(tmp_path / "d", tasks["slider"], {})
    document_ = json.loads((source / "diagnosis.json").read_text())
    (source / "diagnosis.json").write_text(json.dumps(document_ | changed))
    with pytest.raises(StoreError, match=fault):
        export(result=source, out=tmp_path / "m.xml")


def test_the_command_says_what_it_wrote(capture, tasks, tmp_path):
    diagnosis(tmp_path / "d", tasks["slider"], found_at("cogging@x", where="slider"))

    def run(*options: str) -> tuple[str, str]:
        code, *said = capture("export", "d", "--out", "m.xml", *options)
        assert code == 0
        return said

    out, err = run()
    assert "m.xml: written" in out
    assert "m_effects.py: written; it applies cogging@x" in out
    assert err == ""
    assert json.loads(run("--force", "--json")[0]) == {"model": "m.xml", "companion": "m_effects.py"}
    file = tmp_path / "d" / "diagnosis.json"
    doubted = {"verdict": "unexplained", "summary": "This is not all."}
    file.write_text(json.dumps(json.loads(file.read_text()) | doubted))
    assert run("--force")[1] == "warning: d is 'unexplained'. This is not all.\n"
    assert run("--force", "--quiet")[1] == ""


def test_every_effect_of_the_catalogue_says_how_it_is_exported():
    page = (Path(__file__).parents[1] / "docs" / "effects.md").read_text(encoding="utf-8")
    for entry in effects.catalogue():
        place, exported_as = entry.kind.place, entry.kind.exported_as()
        assert exported_as == ("MJCF" if place == "model" else "companion")
        section = page.split(f"## {place.capitalize()}\n")[1].split("\n## ")[0]
        says, _, rows = section.partition("\n|")
        assert ("model.xml" if exported_as == "MJCF" else "a companion") in says
        own = next(row for row in rows.splitlines() if row.startswith(f"| `{entry.name}` |"))
        assert "Not exported" not in own
