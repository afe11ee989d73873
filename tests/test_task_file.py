"""task.toml: what it may say, and that every mistake is named with its place and its cure."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import mujoco
import numpy as np
import pytest

from capture_cli.errors import CaptureError, ModelError, TaskError
from capture_cli.log.checks.parameter_bounds import doubtful_bounds
from capture_cli.log.input_sequences import EVENLY
from capture_cli.model.effects.com_shift import ComShift
from capture_cli.model.fields import ModelFields
from capture_cli.model.mjcf.mjcf_writer import to_mjcf
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks import load_task
from capture_cli.simulate.engine import Engine

MODEL = """
<mujoco>
  <option timestep="0.004"/>
  <worldbody>
    <body name="left"><joint name="a" type="slide" damping="2"/><geom name="l" size=".1" mass="1.5"/></body>
    <body name="right" pos="0 3 0"><freejoint name="f"/><geom name="r" size=".1" mass="1.5"/></body>
  </worldbody>
  <actuator><motor name="push" joint="a"/><motor name="pull" joint="a"/></actuator>
  <sensor>
    <jointpos name="q" joint="a"/>
    <framepos name="where" objtype="xbody" objname="right"/>
    <framequat name="how" objtype="xbody" objname="right"/>
  </sensor>
</mujoco>
"""
TASK = """
format = 1
name = "pair"
model = "model.xml"

[parameters.mass]
set = "body:left:mass"
low = 0.5
high = 4.0
unit = "kg"

[inputs.push]
column = "u"
unit = "N"

[outputs.q]
column = "q_m"
unit = "m"

[log]
time = "t_s"
window = 0.5
"""
FORMAT, PARAMETER, INPUT, OUTPUT, LOG = (
    "task.toml",
    "[parameters.mass]",
    "[inputs.push]",
    "[outputs.q]",
    "[log]",
)


@pytest.fixture
def write(tmp_path):
    """Writes a task.toml beside the model; the text of TASK with replacements made in it."""

    def write(*replacements: tuple[str, str], extra: str = "") -> Path:
        text = TASK
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new, 1)
        (tmp_path / "model.xml").write_text(MODEL)
        path = tmp_path / "task.toml"
        path.write_text(text + extra)
        return path

    return write


def test_a_task_in_full(write):
    task = load_task(str(write()))
    assert (task.name, task.timestep, task.space.names) == ("pair", 0.004, ("mass",))
    mass = task.space.parameters[0]
    assert (mass.low, mass.high, mass.nominal, mass.unit) == (0.5, 4.0, 1.5, "kg")  # nominal: the model's own
    assert [(c.name, c.column, c.unit, c.scale, c.offset, c.hold) for c in task.inputs] == [
        ("push", "u", "N", 1.0, 0.0, None)  # what it does between rows, the log has to tell
    ]
    assert [(c.name, c.column, c.index, c.noise_sd) for c in task.outputs] == [("q", "q_m", 0, None)]
    assert (task.log.time, task.log.episode, task.log.window) == ("t_s", None, 0.5)
    assert task.log.time_scale == 1.0


def test_a_folder_stands_for_the_task_in_it(write):
    assert load_task(str(write().parent)).name == "pair"


def test_optional_keys(write):
    task = load_task(
        str(
            write(
                ('name = "pair"\n', ""),
                ('unit = "kg"', 'unit = "kg"\nnominal = 3'),
                ('unit = "N"', 'unit = "N"\nscale = 2\noffset = -1.5\ninterpolate = "linear"'),
                ('column = "q_m"', 'column = "q_m"\nscale = 0.001\noffset = 0.25\nnoise_sd = 1e-4'),
                ('time = "t_s"\nwindow = 0.5', 'episode = "run"\ntime_scale = 1e-6'),
            )
        )
    )
    assert task.name == task.path.parent.name
    assert task.space.nominal.tolist() == [3.0]
    push, q = task.inputs[0], task.outputs[0]
    assert (push.scale, push.offset, push.hold) == (2.0, -1.5, EVENLY)
    assert (q.scale, q.offset, q.noise_sd) == (0.001, 0.25, 1e-4)
    assert (task.log.time, task.log.episode, task.log.window) == ("time", "run", None)
    assert task.log.time_scale == 1e-6


def test_sensors_with_several_values_become_an_output_each(write):
    extra = """
[outputs.where]
column = ["px", "py", "pz"]
unit = "m"
[outputs.how]
column = ["w", "i", "j", "k"]
unit = "1"
"""
    outputs = load_task(str(write(extra=extra))).outputs
    assert [c.name for c in outputs] == [
        *("q", "where_x", "where_y", "where_z", "how_w", "how_x", "how_y", "how_z"),
    ]
    assert [c.column for c in outputs] == ["q_m", "px", "py", "pz", "w", "i", "j", "k"]
    assert [c.index for c in outputs] == list(range(8))
    assert [c.sensor for c in outputs] == [0, 1, 1, 1, 2, 2, 2, 2]


def test_a_parameter_may_set_several_targets(write):
    task = load_task(str(write(('"body:left:mass"', '["body:left:mass", "body:right:mass"]'))))
    fields = ModelFields(task.model, 2)
    task.write(fields, np.array([[2.0], [3.0]]))
    assert fields["body_mass"][:, 1:].tolist() == [[2.0, 2.0], [3.0, 3.0]]


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize(
    ("scaling", "absolute", "field"),
    [
        ("body:left:mass", "body:left:inertia_y", "body_inertia"),
        ("body:left:inertia", "body:left:inertia_z", "body_inertia"),
        ("geom:l:size", "geom:l:size_y", "geom_size"),
    ],
)
def test_a_number_is_what_it_says_whichever_parameter_stands_first(write, scaling, absolute, field, swapped):
    pair = (absolute, scaling) if swapped else (scaling, absolute)
    second = f'[parameters.second]\nset = "{pair[1]}"\nlow = 0.01\nhigh = 9.0\nunit = "-"\n'
    path = write(("body:left:mass", pair[0]), ("low = 0.5", "low = 0.01"), extra=second)
    box = MODEL.replace('name="l" size=".1"', 'name="l" type="box" size=".1 .2 .3"')
    (path.parent / "model.xml").write_text(box)
    task = load_task(str(path))
    fields = ModelFields(task.model, 1)
    task.write(fields, np.where(swapped, [[0.09, 3.0]], [[3.0, 0.09]]))
    unscaled = getattr(task.model, field)[1 if field == "body_inertia" else 0]
    written = fields[field][0, 1 if field == "body_inertia" else 0]
    assert (written == 0.09).sum() == 1
    assert (written != unscaled).all()


@pytest.mark.parametrize(
    ("target", "refused"),
    [
        *(
            (t, True)
            for t in ("body:left:inertia_x", "geom:l:size", "geom:l:friction", "joint:a:frictionloss")
        ),
        *((t, True) for t in ("joint:a:armature", "option:viscosity")),
        *(
            (t, False)
            for t in ("joint:a:damping", "joint:a:stiffness", "body:left:com_x", "actuator:push:gain")
        ),
    ],
)
def test_what_cannot_be_negative_has_no_bound_below_zero(write, target, refused):
    path = write(("body:left:mass", target), ("low = 0.5", "low = -0.5"))
    with pytest.raises(TaskError, match=f"low = -0.5, and '{target}' cannot") if refused else nullcontext():
        load_task(str(path))


def test_a_task_may_have_no_parameters_and_no_inputs(write):
    text = TASK[: TASK.index("[parameters")] + TASK[TASK.index("[outputs") :]
    path = write()
    path.write_text(text)
    task = load_task(str(path))
    assert (len(task.space), task.inputs) == (0, ())
    assert task.controls(np.zeros((5, 0))).shape == (5, 2)


def test_inputs_reach_their_actuators(write):
    task = load_task(str(write(("inputs.push", "inputs.pull"))))
    assert task.controls(np.array([[7.0]])).tolist() == [[0.0, 7.0]]


def test_a_nominal_outside_the_bounds_is_brought_inside_if_it_is_the_models(write):
    assert load_task(str(write(("low = 0.5", "low = 2.0")))).space.nominal.tolist() == [2.0]


# replaced text, by what; where; what the message and its cure must name
MISTAKES = {
    "format-missing": ("format = 1\n", "", "task.toml", ["'format' is missing", "`format = 1`"]),
    "format-true": ("format = 1", "format = true", "task.toml", ["format = True", "reads 1", "`format = 1`"]),
    "format-version": ("format = 1", "format = 2", "task.toml", ["format = 2", "reads 1", "`format = 1`"]),
    "unknown-key": ("name =", "nme =", "task.toml", ["'nme'", "did you mean 'name'"]),
    "unknown-table": ("[inputs.push]", "[input.push]", "task.toml", ["'input'", "'inputs'"]),
    "name-type": ('"pair"', "5", "task.toml", ["name = 5", "a string"]),
    "model-missing-key": ('model = "model.xml"\n', "", "task.toml", ["'model' is missing", "add `model"]),
    "model-missing-file": ('"model.xml"', '"modl.xml"', "modl.xml", ["does not exist", "model = ..."]),
    "parameters-no-table": ("[parameters.mass]", "[parameters]", "parameters", ["not a table", "[table]"]),
    "parameter-unknown-key": ("low =", "lo =", PARAMETER, ["'lo'", "did you mean 'low'"]),
    "parameter-missing-low": ("low = 0.5\n", "", PARAMETER, ["'low' is missing", "a number"]),
    "parameter-missing-high": ("high = 4.0\n", "", PARAMETER, ["'high' is missing", "a number"]),
    "parameter-missing-unit": ('unit = "kg"\n', "", PARAMETER, ["'unit' is missing", "a string"]),
    "parameter-missing-set": ('set = "body:left:mass"\n', "", PARAMETER, ["'set' is missing", "KIND:NAME:ATTRIBUTE"]),
    "parameter-empty-set": ('"body:left:mass"', "[]", PARAMETER, ["set = []", "KIND:NAME:ATTRIBUTE"]),
    "parameter-set-type": ('"body:left:mass"', "[1]", PARAMETER, ["set = [1]", "KIND:NAME:ATTRIBUTE"]),
    "parameter-low-type": ("low = 0.5", 'low = "0.5"', PARAMETER, ["low = '0.5'", "a number"]),
    "parameter-low-nan": ("low = 0.5", "low = nan", "", ["parameters.mass.low = nan", "finite number"]),
    "parameter-low-vast": ("low = 0.5", "low = -1e308", PARAMETER, ["low = -1e+308", "1e+15 in SI units"]),
    "parameter-high-infinite": ("high = 4.0", "high = inf", "", ["parameters.mass.high = inf", "finite number"]),
    "parameter-low-bool": ("low = 0.5", "low = true", PARAMETER, ["low = True", "a number"]),
    "parameter-bounds": ("high = 4.0", "high = 0.25", PARAMETER, ["low = 0.5, high = 0.25", "low < high"]),
    "parameter-bounds-equal": ("high = 4.0", "high = 0.5", PARAMETER, ["low = 0.5, high = 0.5", "low < high"]),
    "parameter-name-empty": ("[parameters.mass]", '[parameters.""]', "[parameters.]", ["no name", "[parameters.NAME]"]),
    "parameter-below-zero": ("low = 0.5", "low = -1", PARAMETER, ["'body:left:mass' cannot be below 0", "0 or more"]),
    "parameter-of-the-world": ("body:left:mass", "body:world:mass", PARAMETER, ["the world does not move", "a body"]),
    "parameter-nominal": ("high = 4.0", "high = 4.0\nnominal = 5", PARAMETER, ["nominal = 5", "[0.5, 4]", "inside"]),
    "parameter-same-target": (
        'unit = "kg"',
        'unit = "kg"\n[parameters.load]\nset = ["body:right:mass", "body:left:mass"]\nlow = 1\nhigh = 2\nunit = "kg"',
        "[parameters.load]",
        ["sets 'body:left:mass'", "[parameters.mass]", "one of them"],
    ),
    "parameter-target-twice": (
        '"body:left:mass"',
        '["body:left:mass", "body:right:mass", "body:left:mass"]',
        PARAMETER,
        ["'body:left:mass' twice", "once"],
    ),
    "target-kind": ("body:left:mass", "bod:left:mass", PARAMETER, ["'bod:left:mass'", "'body'", "joint"]),
    "target-name": ("body:left:mass", "body:lft:mass", PARAMETER, ["no body 'lft'", "'left'", "right"]),
    "target-attribute": ("body:left:mass", "body:left:mas", PARAMETER, ["'mas'", "'mass'", "inertia"]),
    "input-actuator": ("inputs.push", "inputs.psh", "[inputs.psh]", ["no actuator 'psh'", "'push'", "pull"]),
    "input-unknown-key": ('column = "u"', 'column = "u"\ngain = 2', INPUT, ["'gain'", "scale"]),
    "input-column": ('column = "u"\n', "", INPUT, ["'column' is missing", "a string"]),
    "input-column-type": ('column = "u"', 'column = ["u"]', INPUT, ["column = ['u']", "a string"]),
    "input-unit": ('unit = "N"\n', "", INPUT, ["'unit' is missing"]),
    "input-scale": ('unit = "N"', 'unit = "N"\nscale = "2"', INPUT, ["scale = '2'", "a number"]),
    "input-scale-zero": ('unit = "N"', 'unit = "N"\nscale = 0', INPUT, ["scale = 0", "the factor"]),
    "input-interpolate": ('unit = "N"', 'unit = "N"\ninterpolate = "cubic"', INPUT, ["'cubic'", '"hold"', '"linear"']),
    "input-late": ('unit = "N"', 'unit = "N"\ninterpolate = "hold"\nlate = 4', INPUT, ["late = 4", "seconds"]),
    "input-late-alone": ('unit = "N"', 'unit = "N"\nlate = 0.004', INPUT, ["late without interpolate"]),
    "input-interpolate-1": ('unit = "N"', 'unit = "N"\ninterpolate = 1', INPUT, ["interpolate = 1", "2 to 100"]),
    "output-sensor": ("outputs.q", "outputs.qq", "[outputs.qq]", ["no sensor 'qq'", "'q'", "where"]),
    "output-joint": ("outputs.q", "outputs.a", "[outputs.a]", ["no sensor 'a'", '<jointpos name="a" joint="a"/>']),
    "output-unknown-key": ('column = "q_m"', 'column = "q_m"\nnoise = 1', OUTPUT, ["'noise'", "'noise_sd'"]),
    "output-column": ('column = "q_m"\n', "", OUTPUT, ["'column' is missing", "has 1 value\n", "one column"]),
    "output-column-type": ('column = "q_m"', "column = 3", OUTPUT, ["column = 3", "one column"]),
    "output-columns": ("outputs.q", "outputs.where", "[outputs.where]", ["3 values", "a list of 3"]),
    "output-unit": ('unit = "m"\n', "", OUTPUT, ["'unit' is missing"]),
    "output-period-of-degrees": (
        'unit = "m"',
        'unit = "rad"\nperiod = 360',
        OUTPUT,
        ["period = 360 is a whole turn in deg", "write period = 6.28319"],
    ),
    "output-period": ('unit = "m"', 'unit = "m"\nperiod = -360', OUTPUT, ["period = -360", "360 for degrees"]),
    "output-sparse": ('unit = "m"', 'unit = "m"\nsparse = 1', OUTPUT, ["sparse = 1", "true or false"]),
    "input-sparse": ('unit = "N"', 'unit = "N"\nsparse = true', INPUT, ["unknown key 'sparse'"]),
    "output-scale-zero": ('unit = "m"', 'unit = "m"\nscale = 0.0', OUTPUT, ["scale = 0", "the factor"]),
    "output-noise": ('unit = "m"', 'unit = "m"\nnoise_sd = 0', OUTPUT, ["noise_sd = 0", "positive"]),
    "outputs-none": ('[outputs.q]\ncolumn = "q_m"\nunit = "m"', "", "task.toml", ["no [outputs.NAME]", "sensor"]),
    "log-unknown-key": ("window", "windows", LOG, ["'windows'", "did you mean 'window'"]),
    "log-window": ("window = 0.5", "window = -1.0", LOG, ["window = -1", "positive"]),
    "log-window-type": ("window = 0.5", 'window = "0.5"', LOG, ["window = '0.5'", "a number"]),
    "log-time-scale": ("window = 0.5", "time_scale = 0", LOG, ["time_scale = 0", "1e-3 for milliseconds"]),
    "log-time-scale-type": ("window = 0.5", 'time_scale = "ms"', LOG, ["time_scale = 'ms'", "a number"]),
    "log-time-type": ('time = "t_s"', "time = 5", LOG, ["time = 5", "a string"]),
    "log-no-table": ("[log]", "[[log]]", LOG, ["not a table", "[table]"]),
    "not-toml": ("format = 1", "format = ", "task.toml", ["is not TOML", "line 2", "correct the file"]),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named_with_its_place_and_cure(write, name):
    old, new, where, named = MISTAKES[name]
    with pytest.raises((TaskError, ModelError)) as caught:
        load_task(str(write((old, new))))
    assert where in caught.value.message
    assert caught.value.cure
    for piece in named:
        assert piece in str(caught.value)


def test_a_file_that_is_not_text(tmp_path):
    path = tmp_path / "task.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TaskError, match="is not UTF-8"):
        load_task(str(path))


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ('<motor name="push" joint="a"/>', '<orientation name="push" joint="f" kp="1"/>', "takes 3 controls"),
        ('name="push" joint="a"', 'name="push" joint="a" delay="0.008" nsample="3"', "delay = 0.008 s"),
        ('name="q" joint="a"', 'name="q" joint="a" delay="0.008" nsample="3"', "delay or an interval"),
        ('name="q" joint="a"', 'name="q" joint="a" interval="0.02"', "delay or an interval"),
    ],
)
def test_actuators_and_sensors_that_windows_cannot_restart(write, tmp_path, old, new, named):
    path = write()
    model = MODEL.replace('<freejoint name="f"/>', '<joint name="f" type="ball"/>')
    model = model.replace('<framepos name="where" objtype="xbody" objname="right"/>', "")
    assert old in model
    (tmp_path / "model.xml").write_text(model.replace(old, new))
    with pytest.raises(ModelError, match=named) as caught:
        load_task(str(path))
    assert caught.value.cure


@pytest.mark.parametrize(
    ("unit", "right"), [("deg", "rad"), ("°", "rad"), ("Degrees", "rad"), ("deg/s", "rad/s")]
)
def test_a_sensor_of_an_angle_reports_no_degrees(write, tmp_path, unit, right):
    path = write(('unit = "m"', f'unit = "{unit}"'))
    load_task(str(path))  # of a joint that slides nobody knows what unit its model has
    model = MODEL.replace('type="slide"', 'type="hinge"')
    if "/" in right:
        model = model.replace('jointpos name="q"', 'jointvel name="q"')
    (tmp_path / "model.xml").write_text(model)
    with pytest.raises(
        TaskError, match=rf"outputs\.q\]: unit = '{unit}' .* the sensor reports {right}:"
    ) as caught:
        load_task(str(path))
    assert (
        caught.value.cure == f'write unit = "{right}"; and if the column is in {unit}, column_unit = "{unit}"'
    )


@pytest.mark.parametrize(
    ("unit", "sensor", "right", "scale"),
    [
        ("mm", 'jointpos name="q" joint="a"', "m", 0.001),
        ("µm", 'jointpos name="q" joint="a"', "m", 1e-06),
        ("cm/s", 'jointvel name="q" joint="a"', "m/s", 0.01),
        ("km/h", 'jointvel name="q" joint="a"', "m/s", 0.27777778),
        ("kN", 'jointactuatorfrc name="q" joint="a"', "N", 1000),
        ("mrad", 'jointpos name="q" joint="a" hinge', "rad", 0.001),
        ("RPM", 'jointvel name="q" joint="a" hinge', "rad/s", 0.10471976),
        ("rev/min", 'jointvel name="q" joint="a" hinge', "rad/s", 0.10471976),
        ("deg s^-1", 'jointvel name="q" joint="a" hinge', "rad/s", 0.017453293),
        ("mN m", 'jointactuatorfrc name="q" joint="a" hinge', "N m", 0.001),
        ("N·mm", 'jointactuatorfrc name="q" joint="a" hinge', "N m", 0.001),
        ("kgf cm", 'jointactuatorfrc name="q" joint="a" hinge', "N m", 0.0980665),
    ],
)
def test_a_sensor_reports_its_unit_without_a_prefix(write, tmp_path, unit, sensor, right, scale):
    path = write(('unit = "m"', f'unit = "{unit}"'))
    model = MODEL.replace('jointpos name="q" joint="a"', sensor.removesuffix(" hinge"))
    if sensor.endswith("hinge"):
        model = model.replace('type="slide"', 'type="hinge"')
    (tmp_path / "model.xml").write_text(model)
    with pytest.raises(TaskError, match=rf"outputs\.q\]: unit = .* the sensor reports {right}:") as caught:
        load_task(str(path))
    assert caught.value.cure.endswith(
        f'unit = "{right}"; and if the column is in {unit}, column_unit = "{unit}"'
    )
    path = write(('unit = "m"', f'column_unit = "{unit}"\nunit = "{right}"\nscale = -2'))
    assert load_task(str(path)).outputs[0].scale == pytest.approx(-2 * scale)


@pytest.mark.parametrize(
    ("unit", "sensor", "right"),
    [
        ("deg", "jointvel", "rad/s"),
        ("deg/s", "jointpos", "rad"),
        ("rpm", "jointpos", "rad"),
    ],
)
def test_a_sensor_of_what_turns_reports_no_other_power_of_time(write, tmp_path, unit, sensor, right):
    path = write(('unit = "m"', f'unit = "{unit}"'))
    model = MODEL.replace('type="slide"', 'type="hinge"')
    (tmp_path / "model.xml").write_text(model.replace('jointpos name="q"', f'{sensor} name="q"'))
    with pytest.raises(TaskError, match=rf"unit = '{unit}', and the sensor reports {right}, which") as caught:
        load_task(str(path))
    assert f'write unit = "{right}"' in caught.value.cure
    path = write(('unit = "m"', f'column_unit = "{unit}"\nunit = "{right}"'))
    with pytest.raises(
        TaskError, match=f"column_unit = '{unit}' is no unit of what unit = '{right}' measures"
    ):
        load_task(str(path))


@pytest.mark.parametrize(
    ("unit", "column_unit", "said", "cure"),
    [
        (
            "m",
            "deg",
            "column_unit = 'deg' is no unit of what unit = 'm' measures",
            "write one of m, nm, um, mm",
        ),
        ("counts", "deg", "no other units are known of unit = 'counts'", "scale = ..."),
    ],
)
def test_a_column_of_something_else_is_refused(write, unit, column_unit, said, cure):
    path = write(('unit = "m"', f'unit = "{unit}"\ncolumn_unit = "{column_unit}"'))
    with pytest.raises(TaskError, match=r"outputs\.q\]: .*" + said) as caught:
        load_task(str(path))
    assert cure in caught.value.cure


@pytest.mark.parametrize(
    ("unit", "refused"), [("g", True), ("mm/s²", True), ("mm/s/s", True), ("m/s2", False), ("m s^-2", False)]
)
def test_an_accelerometer_reports_no_weights(write, tmp_path, unit, refused):
    path = write(('unit = "m"', f'unit = "{unit}"'), ('column = "q_m"', 'column = ["x", "y", "z"]'))
    model = MODEL.replace('jointpos name="q" joint="a"', 'accelerometer name="q" site="at"')
    (tmp_path / "model.xml").write_text(model.replace("</body>", '<site name="at"/></body>', 1))
    with pytest.raises(TaskError, match="the sensor reports m/s") if refused else nullcontext():
        load_task(str(path))


@pytest.mark.parametrize("unit", ["m", "1", "counts", "ticks", "px", "V", "N m", "mmHg"])
def test_words_that_are_no_form_of_a_sensors_unit_are_left_alone(write, unit):
    (output,) = load_task(str(write(('unit = "m"', f'unit = "{unit}"')))).outputs
    assert (output.unit, output.scale) == (unit, 1.0)


def test_a_control_goes_to_its_actuator_behind_one_of_many_controls(write, tmp_path):
    path = write()
    model = MODEL.replace('<freejoint name="f"/>', '<joint name="f" type="ball"/>')
    model = model.replace("<actuator>", '<actuator><orientation name="turn" joint="f" kp="1"/>')
    (tmp_path / "model.xml").write_text(model)
    assert load_task(str(path)).controls(np.array([[7.0]])).tolist() == [[0.0, 0.0, 0.0, 7.0, 0.0]]


def test_a_model_that_does_not_compile(write, tmp_path):
    path = write()
    (tmp_path / "model.xml").write_text(MODEL.replace('type="slide"', 'type="slid"'))
    with pytest.raises(ModelError) as caught:
        load_task(str(path))
    assert "does not compile" in caught.value.message
    assert "line 5" in caught.value.message
    assert "joint" in caught.value.message


def test_a_model_that_is_a_folder(write, tmp_path):
    (tmp_path / "folder.xml").mkdir()
    with pytest.raises(ModelError, match=r"folder\.xml"):
        load_task(str(write(("model.xml", "folder.xml"))))


@pytest.mark.parametrize("name", ["nowhere.toml", "no-such-task", ""])
def test_a_task_that_is_not_there(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(TaskError) as caught:
        load_task(name)
    assert repr(name) in caught.value.message
    assert "task.toml" in caught.value.cure


def test_a_table_declared_twice(write):
    """TOML itself refuses a table that is declared twice; the message names the line."""
    with pytest.raises(CaptureError, match=r"is not TOML.*line"):
        load_task(str(write(extra='\n[outputs.q]\ncolumn = "again"\nunit = "m"\n')))


def test_the_model_is_the_one_mujoco_loads(write, tmp_path):
    task = load_task(str(write()))
    assert task.model.nbody == mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml")).nbody == 3


BOX = """
<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody>
  <body name="box"><freejoint/><geom type="box" size=".1 .06 .03" mass="2"/></body>
  <body name="sled" pos="0 3 0"><joint name="x" type="slide" axis="1 0 0"/><geom size=".1" mass="1"/></body>
</worldbody><sensor><framepos name="p" objtype="xbody" objname="box"/></sensor></mujoco>
"""
BOX_TASK = """
format = 1
name = "box"
model = "box.xml"
[parameters.com]
set = "body:box:com_x"
low = -0.05
high = 0.05
unit = "m"
[parameters.sled]
set = "body:sled:com_z"
low = -0.05
high = 0.05
unit = "m"
[outputs.p]
column = ["x", "y", "z"]
unit = "m"
"""


@pytest.mark.parametrize("effect", [False, True])
def test_the_centre_of_mass_of_a_simple_body_can_be_moved_and_is_exported(tmp_path, effect):
    """MuJoCo compiles a body with its centre in its frame as "simple", and would then not move it."""
    (tmp_path / "box.xml").write_text(BOX)
    (tmp_path / "task.toml").write_text(BOX_TASK)
    task = load_task(str(tmp_path / "task.toml"))
    plain = mujoco.MjModel.from_xml_path(str(tmp_path / "box.xml"))
    assert plain.body_simple.all() and not task.model.body_simple[1:].any()
    fields = ModelFields(task.model, 1)
    if effect:
        assert ComShift.sites(task.model) == ["box"]
        ComShift(task.model, "box").write(fields, np.array([[0.03, 0, 0]]))
    else:
        task.write(fields, np.array([[0.03, 0.01]]))
    start = InitialStates(task.model.qpos0[None], np.ones((1, task.model.nv)), np.zeros((1, 0)), np.zeros(1))
    options = {"initial": start, "controls": np.zeros((1, 300, 0))}
    found = Engine(task.model, 1).rollout(**options, fields=fields).sensors
    (tmp_path / "out.xml").write_text(to_mjcf(tmp_path / "box.xml", fields, tmp_path / "out.xml"))
    exported = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    assert exported.body("box").ipos[0] == 0.03
    np.testing.assert_allclose(found, Engine(exported, 1).rollout(**options).sensors, atol=1e-12)
    assert np.abs(found - Engine(plain, 1).rollout(**options).sensors).max() > 1e-3


@pytest.mark.parametrize("first", ["mass", "com"])
def test_the_centres_that_are_moved_do_not_depend_on_the_order_of_parameters(tmp_path, first):
    """Both bodies only slide: of one the mass is open, of the other the centre of mass."""
    model = BOX.replace("<freejoint/>", '<joint type="slide" axis="1 0 0"/>')
    (tmp_path / "box.xml").write_text(model.replace('name="sled"', 'name="robot0:sled"'))
    mass = '[parameters.mass]\nset = "body:box:mass"\nlow = 1\nhigh = 3\nunit = "kg"\n'
    com = '[parameters.com]\nset = "body:robot0:sled:com_z"\nlow = -0.05\nhigh = 0.05\nunit = "m"\n'
    head, rest = BOX_TASK[: BOX_TASK.index("[parameters.com]")], BOX_TASK[BOX_TASK.index("[outputs.p]") :]
    (tmp_path / "task.toml").write_text(head + (mass + com if first == "mass" else com + mass) + rest)
    task = load_task(str(tmp_path / "task.toml"))
    assert task.model.body_simple[1:].astype(bool).tolist() == [True, False]
    fields = ModelFields(task.model, 1)
    task.write(fields, np.array([[2.5, 0.03] if first == "mass" else [0.03, 2.5]]))
    assert fields["body_mass"][0, 1] == 2.5
    assert fields["body_ipos"][0, 2].tolist() == [0, 0, 0.03]


def test_bounds_wider_than_any_place_are_warned_of(write):
    """On both sides of 0 they say no size that they could be compared with."""
    task = load_task(str(write(("low = 0.5", "low = 0.0"), ("body:left:mass", "body:left:com_x"))))
    assert not [*doubtful_bounds(task)]
    vast = write(("low = 0.5", "low = -1e9"), ("body:left:mass", "body:left:com_x"))
    (found,) = doubtful_bounds(load_task(str(vast)))
    assert found["severity"] == "warning" and "wider than any place" in found["message"]


@pytest.mark.parametrize(
    ("low", "high", "said"), [(200.0, 900.0, True), (0.001, 0.02, True), (0.5, 3.0, False), (2.5, 9.0, False)]
)
def test_bounds_in_another_unit_than_the_model_s_are_warned_of(write, low, high, said):
    """Of a mass of 1.5 kg, in g, and as small as an inertia; a model may be wrong."""
    task = load_task(str(write(("low = 0.5", f"low = {low}"), ("high = 4.0", f"high = {high}"))))
    found = [f for f in doubtful_bounds(task) if "the model's own value" in f["message"]]
    assert [f["cure"].startswith("give bounds of body:left:mass, whose unit is kg") for f in found] == [
        True
    ] * said
