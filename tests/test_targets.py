"""What a parameter can set: every attribute reads, writes and exports; what cannot be set is refused by name."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from matplotlib import image
from mujoco import batch

from capture_cli.errors import ModelError
from capture_cli.model.fields import ModelFields, model_field
from capture_cli.model.mjcf import mjcf_writer as mjcf
from capture_cli.model.mjcf.mjcf_writer import to_mjcf
from capture_cli.model.states import InitialStates
from capture_cli.model.target_attributes import ATTRIBUTES
from capture_cli.model.target_names import parse_target
from capture_cli.model.targets import damping_ratio, restitution
from capture_cli.simulate.engine import Engine, Keep

# Something of everything that can be set, none of it at a default.
XML = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast" gravity="0.1 0.2 -9.7" density="1.1" viscosity="0.02"
          wind="0.3 0.4 0.5"/>
  <worldbody>
    <geom name="floor" type="plane" size="9 9 .1" friction="0.7 0.01 0.002" solref="-4000 -30"/>
    <body name="link" pos="0 0 1">
      <joint name="hinge" type="hinge" axis="0 1 0" damping="0.3 0.2 0.1" frictionloss="0.05" armature="0.01"
             stiffness="2 3 4" springref="30"/>
      <geom name="box" type="box" size="0.1 0.2 0.3" mass="1.5" pos="0.01 0.02 0.03"/>
      <geom name="capsule" type="capsule" size="0.05 0.2" mass="0.1" pos="0 0 .2" euler="20 0 0"/>
    </body>
    <body name="sled" pos="2 0 0.1">
      <inertial pos="0.01 0.02 0.03" mass="2" diaginertia="0.04 0.03 0.02"/>
      <joint name="slide" type="slide" axis="1 0 0" damping="0.4" springref="0.2" stiffness="5"/>
      <geom name="cylinder" type="cylinder" size="0.1 0.05"/>
    </body>
    <body name="swing" pos="-2 0 1">
      <joint name="ball" type="ball" damping="0.2" frictionloss="0.01" armature="0.02"/>
      <geom name="ellipsoid" type="ellipsoid" size="0.1 0.15 0.2" pos="0 0 -.3" mass="1"/>
    </body>
    <body name="puck" pos="0 2 0.1">
      <freejoint name="free"/>
      <geom name="sphere" size="0.11" mass="0.4" friction="0.5 0.02 0.003" solref="0.03 0.8"/>
    </body>
  </worldbody>
  <tendon>
    <fixed name="belt" stiffness="6" damping="0.7" frictionloss="0.08">
      <joint joint="hinge" coef="0.3"/><joint joint="slide" coef="1"/>
    </fixed>
    <fixed name="cord"><joint joint="slide" coef="0.5"/></fixed>
  </tendon>
  <actuator>
    <general name="motor" joint="hinge" gainprm="0.08" biastype="affine" biasprm="0 0 -0.03" gear="3"/>
    <motor name="force" joint="slide"/>
    <general name="lagged" joint="slide" dyntype="filterexact" dynprm="0.05" gainprm="2"
             biastype="affine" biasprm="0.1 -0.2 -0.3"/>
    <position name="servo" joint="slide" kp="3" kv="0.4"/>
    <velocity name="wheel" joint="hinge" kv="0.2"/>
  </actuator>
  <sensor>
    <jointpos joint="hinge"/><jointpos joint="slide"/><ballquat joint="ball"/>
    <framepos objtype="xbody" objname="puck"/>
  </sensor>
</mujoco>
"""
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}

# every target, and what the model above says it is (None: MuJoCo computes it)
VALUES = {
    "body:link:mass": 1.6,
    "body:link:com_x": None,
    "body:link:com_y": None,
    "body:link:com_z": None,
    "body:link:inertia": 1.0,
    "body:link:inertia_x": None,
    "body:link:inertia_y": None,
    "body:link:inertia_z": None,
    "body:sled:mass": 2.0,
    "body:sled:com_x": 0.01,
    "body:sled:com_y": 0.02,
    "body:sled:com_z": 0.03,
    "body:sled:inertia": 1.0,
    "body:sled:inertia_x": 0.04,
    "body:sled:inertia_y": 0.03,
    "body:sled:inertia_z": 0.02,
    "joint:hinge:damping": 0.3,
    "joint:hinge:damping_quadratic": 0.2,
    "joint:hinge:damping_cubic": 0.1,
    "joint:hinge:frictionloss": 0.05,
    "joint:hinge:armature": 0.01,
    "joint:hinge:stiffness": 2.0,
    "joint:hinge:stiffness_quadratic": 3.0,
    "joint:hinge:stiffness_cubic": 4.0,
    "joint:hinge:springref": np.radians(30),
    "joint:slide:damping": 0.4,
    "joint:slide:damping_quadratic": 0.0,
    "joint:slide:frictionloss": 0.0,
    "joint:slide:stiffness": 5.0,
    "joint:slide:springref": 0.2,
    "joint:ball:damping": 0.2,
    "joint:ball:frictionloss": 0.01,
    "joint:ball:armature": 0.02,
    "joint:ball:stiffness": 0.0,
    "joint:ball:stiffness_cubic": 0.0,
    "joint:free:damping": 0.0,
    "geom:sphere:size": 0.11,
    "geom:box:size": 0.1,
    "geom:box:size_x": 0.1,
    "geom:box:size_y": 0.2,
    "geom:box:size_z": 0.3,
    "geom:capsule:size": 0.05,
    "geom:capsule:size_y": 0.2,
    "geom:cylinder:size_x": 0.1,
    "geom:ellipsoid:size_z": 0.2,
    "geom:floor:friction": 0.7,
    "geom:floor:friction_torsional": 0.01,
    "geom:floor:friction_rolling": 0.002,
    "geom:floor:solref_timeconst": -4000.0,
    "geom:floor:solref_dampratio": -30.0,
    "geom:floor:restitution": None,
    "geom:sphere:friction": 0.5,
    "geom:sphere:solref_timeconst": 0.03,
    "geom:sphere:restitution": None,
    "tendon:belt:damping": 0.7,
    "tendon:belt:frictionloss": 0.08,
    "tendon:belt:stiffness": 6.0,
    "tendon:cord:damping": 0.0,
    "tendon:cord:frictionloss": 0.0,
    "tendon:cord:stiffness": 0.0,
    "actuator:motor:gain": 0.08,
    "actuator:motor:bias": 0.0,
    "actuator:motor:bias_position": 0.0,
    "actuator:motor:bias_velocity": -0.03,
    "actuator:motor:gear": 3.0,
    "actuator:motor:motor_constant": 0.03 / 0.08,
    "actuator:motor:resistance": 0.03 / 0.08**2,
    "actuator:servo:kp": 3.0,
    "actuator:servo:kv": 0.4,
    "actuator:wheel:kv": 0.2,
    "actuator:force:gain": 1.0,
    "actuator:force:bias": 0.0,
    "actuator:force:bias_velocity": 0.0,
    "actuator:lagged:bias": 0.1,
    "actuator:lagged:bias_position": -0.2,
    "actuator:lagged:bias_velocity": -0.3,
    "actuator:lagged:time_constant": 0.05,
    "option:gravity_x": 0.1,
    "option:gravity_y": 0.2,
    "option:gravity_z": -9.7,
    "option:density": 1.1,
    "option:viscosity": 0.02,
    "option:wind_x": 0.3,
    "option:wind_y": 0.4,
    "option:wind_z": 0.5,
}


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(XML)


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(XML)
    return path


def other_value(text: str, nominal: float) -> float:
    """A value that the target can have and does not."""
    if text.endswith(":restitution"):
        return 0.55
    if ":inertia_" in text:
        return 1.05 * nominal  # a body's largest moment is less than the sum of the others
    return nominal * 1.25 if nominal else 0.125


def written(model, *values: tuple[str, float]) -> ModelFields:
    """The fields of one simulation with each (target, value) written in turn."""
    fields = ModelFields(model, 1)
    for text, value in values:
        parse_target(text, model, "here").write(fields, np.array([value]))
    return fields


def assigned(fields: ModelFields) -> mujoco.MjModel:
    """The model of XML with the values of `fields`, and the constants that derive from them."""
    model = mujoco.MjModel.from_xml_string(XML)
    for name, values in fields.values.items():
        if np.ndim(model_field(model, name)) == 0:
            setattr(model.opt, name.removeprefix("opt."), float(values[0]))
        else:
            model_field(model, name)[...] = values[0]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def numbers(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Every floating-point field of a model and of its options."""
    found = {}
    for owner, prefix in ((model, ""), (model.opt, "opt.")):
        for name in dir(owner):
            value = None if name.startswith("_") else getattr(owner, name)
            if isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype.kind == "f"):
                found[prefix + name] = np.array(value)
    return found


def path_of(model: mujoco.MjModel, fields: ModelFields | None = None) -> np.ndarray:
    """Sensors (step, sensordata) of a short motion in which everything moves."""
    start = InitialStates(
        model.qpos0[None], np.full((1, model.nv), 0.3), np.zeros((1, model.na)), np.zeros(1)
    )
    controls = np.sin(np.arange(300)[None, :, None] / 20) * np.ones(model.nu)
    done = Engine(model, 1).rollout(initial=start, controls=controls, fields=fields)
    assert not done.diverged.any()
    return done.sensors[0]


def test_the_table_covers_every_attribute():
    covered = {(t.split(":")[0], t.split(":")[-1]) for t in VALUES}
    assert covered == {(kind, name) for kind, names in ATTRIBUTES.items() for name in names}


@pytest.mark.parametrize("text", [t for t, value in VALUES.items() if value is not None])
def test_reads_the_models_value(model, text):
    assert parse_target(text, model, "here").read(model) == pytest.approx(VALUES[text], rel=1e-12)


@pytest.mark.parametrize("text", VALUES)
def test_reads_back_what_was_written_in_each_simulation(model, text):
    target = parse_target(text, model, "here")
    nominal = target.read(model)
    values = np.array([nominal, other_value(text, nominal)])
    fields = ModelFields(model, 2)
    target.write(fields, values)
    for row, value in enumerate(values):
        one = ModelFields(model, 1)
        one.values = {name: v[row : row + 1] for name, v in fields.values.items()}
        if text.endswith(":inertia"):  # a factor: relative to the model
            ratio = assigned(one).body_inertia[fields["body_inertia"][row] != model.body_inertia]
            assert ratio == pytest.approx(
                value * model.body_inertia[fields["body_inertia"][row] != model.body_inertia]
            )
        else:
            assert target.read(assigned(one)) == pytest.approx(
                value, rel=1e-7 if "restitution" in text else 1e-12
            )


@pytest.mark.parametrize("text", [t for t in VALUES if not t.endswith(":restitution")])
def test_writing_the_models_own_value_changes_nothing(model, text):
    fields = written(model, (text, parse_target(text, model, "here").read(model)))
    for name, values in fields.values.items():
        if name != "actuator_biastype":
            np.testing.assert_allclose(
                values[0], model_field(model, name), rtol=1e-14, atol=1e-15, err_msg=name
            )


@pytest.mark.parametrize("text", VALUES)
def test_exports_to_a_model_with_the_same_numbers_and_motion(model, source, tmp_path, text):
    fields = written(model, (text, other_value(text, parse_target(text, model, "here").read(model))))
    target = tmp_path / "identified.xml"
    target.write_text(to_mjcf(source, fields, target))
    loaded, wanted = mujoco.MjModel.from_xml_path(str(target)), assigned(fields)
    found, expected = numbers(loaded), numbers(wanted)
    assert len(expected) > 100
    del expected["actuator_acc0"]  # made by the compiler alone, for muscles
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-13, atol=1e-14, err_msg=name)
    np.testing.assert_array_equal(loaded.actuator_biastype, wanted.actuator_biastype)
    np.testing.assert_allclose(path_of(loaded), path_of(model, fields), rtol=0, atol=1e-9)


def test_several_targets_export_together(model, source, tmp_path):
    fields = written(
        model,
        ("body:link:mass", 2.5),
        ("body:link:com_z", 0.1),
        ("joint:hinge:damping_cubic", 0.7),
        ("geom:sphere:restitution", 0.7),
        ("actuator:force:bias", 0.4),
        ("actuator:motor:resistance", 3.0),
        ("option:gravity_x", -0.7),
        ("option:viscosity", 0.5),
    )
    target = tmp_path / "identified.xml"
    target.write_text(to_mjcf(source, fields, target))
    loaded = mujoco.MjModel.from_xml_path(str(target))
    np.testing.assert_allclose(path_of(loaded), path_of(model, fields), rtol=0, atol=1e-9)
    assert np.abs(path_of(loaded) - path_of(model)).max() > 1e-2


FROM_GEOMS = """
<mujoco>
  <compiler inertiafromgeom="true"/>
  <worldbody>
    <body name="arm">
      <joint name="j"/>
      <inertial pos="0 0 0" mass="9" diaginertia="1 1 1"/>
      <geom name="box" type="box" size=".1 .2 .3" mass="2" pos=".1 0 0" euler="10 20 30"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("text", ["body:arm:mass", "body:arm:com_x", "geom:box:size", "joint:j:damping"])
def test_inertia_that_follows_the_geoms_is_exported_as_identified(tmp_path, text):
    (tmp_path / "model.xml").write_text(FROM_GEOMS)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    fields = written(model, (text, 0.15))
    (tmp_path / "out.xml").write_text(to_mjcf(tmp_path / "model.xml", fields, tmp_path / "out.xml"))
    loaded = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    assert parse_target(text, loaded, "here").read(loaded) == pytest.approx(0.15)
    for name in ("body_mass", "body_inertia", "body_ipos", "body_iquat"):
        wanted = fields[name][0] if name in fields.values else getattr(model, name)
        np.testing.assert_allclose(getattr(loaded, name), wanted, rtol=1e-13, err_msg=name)


FULL_INERTIA = """
<mujoco>
  <worldbody>
    <body name="ball">
      <inertial pos="0 0.01 0" mass=".5" fullinertia="1e-3 2e-3 1.5e-3 1e-4 2e-4 -1e-4"/>
      <joint name="j" axis="1 1 1"/>
      <geom name="g" type="sphere" size=".05"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize(
    "text", ["geom:g:size", "body:ball:mass", "body:ball:com_y", "body:ball:inertia", "joint:j:damping"]
)
def test_a_body_with_a_full_inertia_matrix_is_exported_as_identified(tmp_path, text):
    (tmp_path / "model.xml").write_text(FULL_INERTIA)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    fields = written(model, (text, 0.06))
    (tmp_path / "out.xml").write_text(to_mjcf(tmp_path / "model.xml", fields, tmp_path / "out.xml"))
    loaded = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    for name in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "geom_size", "dof_damping"):
        wanted = fields[name][0] if name in fields.values else getattr(model, name)
        np.testing.assert_allclose(getattr(loaded, name), wanted, rtol=1e-13, err_msg=name)


@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass' is deprecated")
def test_a_model_that_sets_the_mass_of_all_bodies_is_named_with_the_cure(tmp_path):
    (tmp_path / "model.xml").write_text(FROM_GEOMS.replace('inertiafromgeom="true"', 'settotalmass="3"'))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    with pytest.raises(ModelError, match="settotalmass scales those of all") as caught:
        to_mjcf(tmp_path / "model.xml", written(model, ("body:arm:mass", 0.15)), tmp_path / "out.xml")
    assert "remove settotalmass" in caught.value.cure


ROD = """
<mujoco>
  <compiler {}/>
  <worldbody>
    <body name="rod">
      <joint name="yaw" axis="0 0 1"/>
      <geom type="capsule" fromto="-.2 0 0 .2 0 0" size=".01" mass="1"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("compiler", ["", 'balanceinertia="true"', 'boundinertia="0.001"'])
def test_inertia_that_no_body_has_is_refused_with_the_cure(tmp_path, compiler):
    (tmp_path / "model.xml").write_text(ROD.format(compiler))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    with pytest.raises(ModelError, match=r"moments of inertia of rod, .* and 0\.02 kg m") as caught:
        to_mjcf(tmp_path / "model.xml", written(model, ("body:rod:inertia_x", 0.02)), tmp_path / "out.xml")
    assert "body:rod:inertia, a factor" in caught.value.cure


@pytest.mark.parametrize("factor", [1.1, 1.3, 1.5])
def test_the_inertia_of_a_flat_body_is_exported(tmp_path, factor):
    """Of which one moment is the sum of the others: times a factor, more by a last digit."""
    flat = '<inertial pos="0 0 0" mass="1" diaginertia=".7 .4 1.1"/>'
    (tmp_path / "model.xml").write_text(ROD.format("").replace("<joint", f"{flat}<joint"))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    fields = written(model, ("body:rod:inertia", factor))
    (tmp_path / "out.xml").write_text(to_mjcf(tmp_path / "model.xml", fields, tmp_path / "out.xml"))
    loaded = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    np.testing.assert_allclose(loaded.body_inertia, fields["body_inertia"][0], rtol=1e-15)


GAINS_FROM_INERTIA = """
<mujoco>
  <worldbody>
    <body name="arm">
      <joint name="j" axis="0 1 0" springdamper="0.2 0.8"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1"/>
      <body name="hand" pos=".3 0 0">
        <joint name="k" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass="0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m" joint="j"/>
    <position name="p" joint="k" kp="20" dampratio="1"/>
    <general name="pushed" joint="k" gainprm="3" biastype="affine" biasprm="0 -2 0.01"/>
  </actuator>
  <sensor><jointpos joint="j"/><jointpos joint="k"/></sensor>
</mujoco>
"""


@pytest.mark.parametrize(
    "values",
    [
        {"body:hand:mass": 2.0},
        {"body:hand:com_x": 0.2},
        {"joint:j:armature": 0.3},
        {"body:arm:mass": 2.0, "joint:j:stiffness": 7.0, "joint:j:damping": 0.7, "actuator:p:kp": 40.0},
        {"body:hand:inertia": 3.0, "actuator:p:kv": 4.0},
    ],
)
def test_gains_that_follow_the_inertia_are_exported_as_they_were_while_it_was_identified(tmp_path, values):
    (tmp_path / "model.xml").write_text(GAINS_FROM_INERTIA)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    fields = written(model, *values.items())
    (tmp_path / "out.xml").write_text(to_mjcf(tmp_path / "model.xml", fields, tmp_path / "out.xml"))
    loaded = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    for name in ("actuator_gainprm", "actuator_biasprm", "jnt_stiffness", "dof_damping"):
        wanted = fields[name][0] if name in fields.values else getattr(model, name)
        np.testing.assert_allclose(getattr(loaded, name), wanted, rtol=1e-13, err_msg=name)
    np.testing.assert_allclose(path_of(loaded), path_of(model, fields), rtol=0, atol=1e-9)


def test_an_attached_model_whose_inertia_follows_its_geoms_is_named_with_the_cure(tmp_path):
    (tmp_path / "sub.xml").write_text(FROM_GEOMS)
    (tmp_path / "model.xml").write_text("""
        <mujoco>
          <asset><model name="sub" file="sub.xml"/></asset>
          <worldbody><body name="base"><attach model="sub" body="arm" prefix="my_"/></body></worldbody>
        </mujoco>""")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    with pytest.raises(ModelError, match="my_arm") as caught:
        to_mjcf(tmp_path / "model.xml", written(model, ("body:my_arm:mass", 0.15)), tmp_path / "out.xml")
    assert 'inertiafromgeom="auto"' in caught.value.cure


# --- what they mean ---


def test_mass_takes_the_inertia_along(model):
    fields = written(model, ("body:sled:mass", 6.0))
    body = model.body("sled").id
    np.testing.assert_allclose(fields["body_inertia"][0, body], 3 * model.body_inertia[body], rtol=1e-15)


def test_damping_of_a_ball_joint_acts_on_all_three_axes(model):
    fields = written(model, ("joint:ball:damping", 0.9))
    first = model.joint("ball").dofadr[0]
    assert fields["dof_damping"][0, first : first + 3].tolist() == [0.9] * 3
    assert fields["dof_damping"][0, first + 3] == model.dof_damping[first + 3]


@pytest.mark.parametrize("value", [0.15, 0.3, 0.5, 0.75, 0.9, 0.999])
def test_restitution_is_the_inverse_of_damping_ratio(value):
    assert restitution(damping_ratio(np.array([value])))[0] == pytest.approx(value, abs=1e-7)


@pytest.mark.parametrize("value", [0.4, 0.6, 0.8])
def test_a_ball_bounces_with_the_restitution_that_was_set(value):
    bouncing = mujoco.MjModel.from_xml_string("""
        <mujoco>
          <option timestep="1e-4" gravity="0 0 0"/>
          <worldbody>
            <geom name="floor" type="plane" size="1 1 .1" solref="-5000 -1000"/>
            <body pos="0 0 .11">
              <joint type="slide" axis="0 0 1"/>
              <geom name="ball" size=".1" mass="1"/>
            </body>
          </worldbody>
        </mujoco>""")
    fields = ModelFields(bouncing, 1)
    for geom in ("floor", "ball"):
        parse_target(f"geom:{geom}:restitution", bouncing, "here").write(fields, np.array([value]))
    start = InitialStates(np.zeros((1, 1)), np.full((1, 1), -0.5), np.zeros((1, 0)), np.zeros(1))
    done = Engine(bouncing, 1).rollout(
        initial=start, controls=np.zeros((1, 1500, 0)), fields=fields, keep=Keep(states=True)
    )
    assert done.qvel[0, -1, 0] / 0.5 == pytest.approx(value, abs=0.01)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_motor_constant_and_resistance_compose_in_any_order(model, order):
    pair = [("actuator:motor:motor_constant", 0.5), ("actuator:motor:resistance", 4.0)]
    fields = written(model, *(pair[i] for i in order))
    motor = model.actuator("motor").id
    assert fields["actuator_gainprm"][0, motor, 0] == pytest.approx(0.5 / 4)
    assert fields["actuator_biasprm"][0, motor, 2] == pytest.approx(-(0.5**2) / 4)


def test_gains_of_servos_are_what_compiling_them_gives(model):
    fields = written(
        model, ("actuator:servo:kp", 5.0), ("actuator:servo:kv", 0.7), ("actuator:wheel:kv", 0.9)
    )
    spec = mujoco.MjSpec.from_string(XML)
    spec.actuator("servo").set_to_position(kp=5.0, kv=0.7)
    spec.actuator("wheel").set_to_velocity(kv=0.9)
    compiled = spec.compile()
    for name in ("actuator_gainprm", "actuator_biasprm"):
        np.testing.assert_array_equal(fields[name][0], getattr(compiled, name))


def test_bias_gives_a_plain_motor_a_constant_force(model):
    with_bias = path_of(model, written(model, ("actuator:force:bias", 0.5)))
    np.testing.assert_array_equal(
        path_of(model, written(model, ("actuator:force:bias", 0.0))), path_of(model)
    )
    assert np.abs(with_bias - path_of(model))[:, 1].max() > 1e-3


@pytest.mark.parametrize(
    ("geom", "axis"), [(g, a) for g, n in SIZES.items() for a in ["", "_x", "_y", "_z"][: n + 1]]
)
def test_size_updates_bounding_volumes_as_compiling_would(model, geom, axis):
    fields = written(model, (f"geom:{geom}:size{axis}", 0.37))
    number = model.geom(geom).id
    spec = mujoco.MjSpec.from_string(XML)
    spec.geom(geom).size = fields["geom_size"][0, number]
    compiled = spec.compile()
    simulated = batch.Batch(model, 1, 1)
    simulated.expand("geom_size")[...] = fields["geom_size"]
    simulated.set_const()
    for name in ("geom_aabb", "geom_rbound"):
        found = simulated.expand(name).reshape(getattr(compiled, name).shape)[number]
        np.testing.assert_allclose(
            found, getattr(compiled, name)[number], rtol=1e-12, atol=1e-15, err_msg=name
        )


def test_a_body_without_mass_becomes_a_point_mass():
    """A tool's frame is where an unknown payload is."""
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><worldbody><body name="arm"><joint/><geom size=".1" mass="1"/><body name="tool" pos="1 0 0"/></body>
        </worldbody></mujoco>""")
    fields = written(model, ("body:tool:mass", 0.5))
    tool = model.body("tool").id
    assert fields["body_mass"][0, tool] == 0.5
    assert fields["body_inertia"][0, tool].tolist() == [0, 0, 0]


def test_size_alone_keeps_the_shape_and_the_mass(model):
    fields = written(model, ("geom:box:size", 0.2))
    np.testing.assert_allclose(fields["geom_size"][0, model.geom("box").id], [0.2, 0.4, 0.6], rtol=1e-15)
    assert "body_mass" not in fields.values


def test_names_may_hold_colons():
    model = mujoco.MjModel.from_xml_string(XML.replace('"link"', '"robot0:arm:link"'))
    assert parse_target("body:robot0:arm:link:mass", model, "task.toml").read(model) == pytest.approx(1.6)
    with pytest.raises(ModelError, match=r"no body 'robot0:arm:lnk'") as caught:
        parse_target("body:robot0:arm:lnk:mass", model, "task.toml")
    assert "robot0:arm:link" in caught.value.cure


# --- what is refused ---


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (
            "bodi:link:mass",
            ["bodi:link:mass", "did you mean 'body'", "actuator, body, geom, joint, option, tendon"],
        ),
        ("body:lnk:mass", ["no body 'lnk'", "did you mean 'link'", "sled"]),
        ("joint:hinge:dampin", ["'dampin'", "did you mean 'damping'", "frictionloss"]),
        ("joint:hing:damping", ["'hing'", "did you mean 'hinge'"]),
        ("geom:bx:size", ["no geom 'bx'", "box"]),
        ("actuator:moto:gain", ["no actuator 'moto'", "'motor'"]),
        ("option:gravity", ["'gravity'", "gravity_x"]),
        ("tendon:bel:stiffness", ["no tendon 'bel'", "did you mean 'belt'"]),
        ("body:mass", ["body:NAME:ATTRIBUTE"]),
        ("body::mass", ["body:NAME:ATTRIBUTE"]),
        ("option", ["option:ATTRIBUTE"]),
        ("option:world:gravity_z", ["option:ATTRIBUTE"]),
        ("", ["unknown kind", "actuator, body, geom, joint, option, tendon"]),
        ("geom:floor:size", ["0 settable sizes"]),
        ("geom:sphere:size_y", ["1 settable sizes", "'size_y'"]),
        ("geom:capsule:size_z", ["2 settable sizes", "'size_z'"]),
        ("actuator:force:motor_constant", ["k/R", "biastype"]),
        ("actuator:force:kv", ["'force'", "servo of position or of velocity", "<velocity"]),
        ("actuator:wheel:kp", ["'wheel'", "servo of position", "<position"]),
        ("actuator:force:time_constant", ["no filter", "filterexact"]),
        ("joint:ball:springref", ["'ball'", "hinge", "slide"]),
        ("joint:free:springref", ["'free'", "hinge", "slide"]),
    ],
)
def test_refused_with_the_candidates(model, text, named):
    with pytest.raises(ModelError) as caught:
        parse_target(text, model, "task.toml: [parameters.p]")
    assert "task.toml: [parameters.p]" in caught.value.message
    assert caught.value.cure
    for piece in named:
        assert piece in str(caught.value)


def test_a_bias_that_is_not_affine_is_refused():
    muscle = mujoco.MjModel.from_xml_string("""
        <mujoco>
          <worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody>
          <actuator><muscle name="m" joint="j" lengthrange="0 1"/></actuator>
        </mujoco>""")
    with pytest.raises(ModelError, match="not affine"):
        parse_target("actuator:m:bias", muscle, "here")


# --- files beside the model ---

MESH = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


@pytest.mark.parametrize("meshdir", ["", "assets", "../shared"])
@pytest.mark.parametrize("where", ["task", "elsewhere/deep", "."])
def test_an_export_finds_its_meshes_and_includes_from_any_folder(tmp_path, meshdir, where):
    folder = tmp_path / "task"
    (folder / meshdir).mkdir(parents=True, exist_ok=True)
    (folder / meshdir / "wedge.obj").write_text(MESH)
    (folder / "more.xml").write_text(
        '<mujoco><worldbody><body name="more"><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    )
    (folder / "model.xml").write_text(f"""
        <mujoco>
          <compiler meshdir="{meshdir}"/>
          <include file="more.xml"/>
          <default><default class="rough"><geom friction="0.9 0.01 0.001"/></default></default>
          <asset><mesh name="wedge" file="wedge.obj"/></asset>
          <worldbody>
            <body name="part"><joint name="j" damping="1"/><geom class="rough" type="mesh" mesh="wedge"/></body>
          </worldbody>
          <keyframe><key qpos="0.5 1 1 1 1 0 0 0"/></keyframe>
        </mujoco>""")
    model = mujoco.MjModel.from_xml_path(str(folder / "model.xml"))
    fields = ModelFields(model, 1)
    parse_target("joint:j:damping", model, "here").write(fields, np.array([2.5]))
    target = tmp_path / where / "identified.xml"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(to_mjcf(folder / "model.xml", fields, target))
    loaded = mujoco.MjModel.from_xml_path(str(target))
    assert loaded.joint("j").damping[0] == 2.5
    model.dof_damping[model.joint("j").dofadr] = 2.5
    expected = numbers(model)
    for name, value in numbers(loaded).items():
        np.testing.assert_allclose(value, expected[name], rtol=1e-12, atol=1e-14, err_msg=name)


def write_image(path: Path, seed: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    image.imsave(path, np.random.default_rng(seed).uniform(size=(4, 4, 3)))


FACES = " ".join(f'file{side}="face.png"' for side in ("right", "left", "up", "down", "front", "back"))
TOOL = """
<mujoco>
  <compiler meshdir="assets" texturedir="assets/skin &amp; bone"/>
  <asset>
    <mesh name="m" file="wedge.obj"/><hfield name="h" file="both.png" size="1 1 1 1"/>
    <texture name="t" type="2d" file="both.png"/><texture name="cube" type="cube" {faces}/>
    {more}
  </asset>
  <worldbody>
    <body name="tool"><geom type="mesh" mesh="m" mass="0.1"/><geom type="hfield" hfield="h"/>{attach}</body>
  </worldbody>
</mujoco>"""
ROBOT = """
<mujoco>
  <compiler meshdir="{meshdir}"/>
  <asset>
    <mesh name="m" file="wedge.obj"/>
    <model name="one" file="../one/tool.xml"/><model name="two" file="../two/tool.xml"/>
  </asset>
  <worldbody>
    <body name="part">
      <joint name="j" damping="1"/><geom type="mesh" mesh="m" mass="1"/>
      <attach model="one" body="tool" prefix="A"/><attach model="two" body="tool" prefix="B"/>
      <attach model="two" body="tool" prefix="C"/>
    </body>
  </worldbody>
</mujoco>"""


@pytest.fixture
def attached(tmp_path) -> Path:
    """A folder with a robot of two tools, one of which holds the other: files of the same name, each its own."""
    more = '<model name="two" file="../two/tool.xml"/>'
    held = '<attach model="two" body="tool" prefix="held_"/>'
    for number, (name, inner) in enumerate({"one": (more, held), "two": ("", "")}.items()):
        folder = tmp_path / name
        for seed, image_name in enumerate(("both.png", "skin & bone/both.png", "skin & bone/face.png")):
            write_image(folder / "assets" / image_name, 10 * number + seed)
        (folder / "assets/wedge.obj").write_text(MESH.replace("v 1 0 0", f"v {number + 2} 0 0"))
        (folder / "tool.xml").write_text(TOOL.format(faces=FACES, more=inner[0], attach=inner[1]))
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot/wedge.obj").write_text(MESH)
    return tmp_path


@pytest.mark.parametrize("meshdir", ["", "../robot"])
@pytest.mark.parametrize("where", ["robot", "elsewhere/deep"])
def test_an_export_finds_the_files_of_attached_models_in_their_own_folders(attached, meshdir, where):
    source, target = attached / "robot/model.xml", attached / where / "identified.xml"
    source.write_text(ROBOT.format(meshdir=meshdir))
    target.parent.mkdir(parents=True, exist_ok=True)
    model = mujoco.MjModel.from_xml_path(str(source))
    target.write_text(to_mjcf(source, written(model, ("joint:j:damping", 2.5)), target))
    loaded = mujoco.MjModel.from_xml_path(str(target))
    assert loaded.joint("j").damping[0] == 2.5
    assert (model.nmesh, model.nhfield, model.ntex) == (5, 4, 8)
    for name in ("mesh_vert", "tex_data", "hfield_data"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(model, name), err_msg=name)


def test_attached_models_alone_have_assets_and_the_robots_folder_of_them_is_not_there(attached):
    source, target = attached / "robot/model.xml", attached / "identified.xml"
    source.write_text(ROBOT.format(meshdir="nowhere").replace("wedge.obj", "../wedge.obj"))
    text = source.read_text().replace('<mesh name="m" file="../wedge.obj"/>', "")
    source.write_text(text.replace('<geom type="mesh" mesh="m" mass="1"/>', '<geom size=".1"/>'))
    model = mujoco.MjModel.from_xml_path(str(source))
    target.write_text(to_mjcf(source, ModelFields(model, 1), target))
    assert mujoco.MjModel.from_xml_path(str(target)).nmesh == model.nmesh == 4


@pytest.mark.parametrize(
    ("broken", "named"),
    [("<mujoco><mesh/></mujoco>", "Schema violation"), ("<mujoco/>", "nq = 0, not 1, nv = 0, not 1")],
)
def test_what_does_not_load_as_it_was_is_not_exported(attached, broken, named, monkeypatch):
    source = attached / "robot/model.xml"
    source.write_text(ROBOT.format(meshdir=""))
    fields = ModelFields(mujoco.MjModel.from_xml_path(str(source)), 1)
    monkeypatch.setattr(mjcf, "name_from", lambda text, *_: broken)
    with pytest.raises(ModelError, match=named) as caught:
        to_mjcf(source, fields, attached / "identified.xml")
    assert caught.value.cure
