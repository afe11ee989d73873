"""What a target can set of each kind of object: unit, meaning, and how it is reached in a model."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import mujoco

from capture_cli.errors import ModelError
from capture_cli.model.targets import (
    ActuatorBias,
    BodyInertia,
    BodyMass,
    FieldTarget,
    GeomSize,
    MotorNumber,
    Restitution,
    ServoGain,
    Target,
)

SIZES = {  # settable ones of a geom
    int(mujoco.mjtGeom.mjGEOM_SPHERE): 1,
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): 2,
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): 2,
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): 3,
    int(mujoco.mjtGeom.mjGEOM_BOX): 3,
}
Making = Callable[[mujoco.MjModel, int, str], Target]
Check = Callable[[mujoco.MjModel, int, str], None]


@dataclass(frozen=True)
class Attribute:
    """What can be set of an object: in which unit, what it means, and its target in a model: target(model, number of
    the object, where it was asked for); that raises ModelError where the object has no such number. least: below it
    there is no such body or medium, or MuJoCo takes the number for 0.
    """

    unit: str
    meaning: str
    target: Making
    least: float = -math.inf


def _unchecked(model: mujoco.MjModel, number: int, where: str) -> None:
    """Every object of the kind has it."""


def _own(target: Callable[[int], Target], check: Check = _unchecked) -> Making:
    """A target of its own class."""

    def make(model: mujoco.MjModel, number: int, where: str) -> Target:
        check(model, number, where)
        return target(number)

    return make


def _field(field: str, *column: int, check: Check = _unchecked) -> Making:
    """An entry of a model field that has a row per object."""
    return _own(lambda number: FieldTarget(field, (number, *column)), check)


def _dof_field(field: str, *column: int) -> Making:
    """An entry of a model field that has a row per degree of freedom: that of all those of a joint."""

    def make(model: mujoco.MjModel, number: int, where: str) -> Target:
        first = model.jnt_dofadr[number]
        count = int((model.dof_jntid == number).sum())
        return FieldTarget(field, (slice(first, first + count), *column))

    return make


def _option(field: str, *column: int) -> Making:
    return lambda model, number, where: FieldTarget(f"opt.{field}", column)


def _bias(column: int) -> Making:
    return _own(lambda number: ActuatorBias(number, column), _check_bias)


def _motor(number: int) -> Making:
    return _own(lambda actuator: MotorNumber(actuator, number), _check_motor)


def _servo(attribute: str) -> Making:
    return lambda model, number, where: _servo_gain(model, number, where, attribute)


def _springref(model: mujoco.MjModel, number: int, where: str) -> Target:
    _check_scalar(model, number, where)
    return FieldTarget("qpos_spring", (model.jnt_qposadr[number],))


def _size(column: int | None = None) -> Making:
    """All sizes of a geom in proportion where `column` is None."""

    def make(model: mujoco.MjModel, number: int, where: str) -> Target:
        sizes = SIZES.get(int(model.geom_type[number]), 0)
        if sizes == 0 or (column is not None and column >= sizes):
            attribute = "size" if column is None else f"size_{'xyz'[column]}"
            raise ModelError(
                f"{where}: this geom has {sizes} settable sizes, and {attribute!r} is not one of them",
                cure="sizes can be set for spheres (x), capsules and cylinders (x, y), ellipsoids and boxes (x, y, z)",
            )
        return GeomSize(number) if column is None else FieldTarget("geom_size", (number, column))

    return make


def _check_moves(model: mujoco.MjModel, number: int, where: str) -> None:
    if number == 0:
        raise ModelError(
            f"{where}: the world does not move, so its mass and inertia are no part of the model",
            cure="name a body that moves",
        )


def _check_scalar(model: mujoco.MjModel, number: int, where: str) -> None:
    kind = mujoco.mjtJoint
    if int(model.jnt_type[number]) not in (kind.mjJNT_HINGE, kind.mjJNT_SLIDE):
        raise ModelError(
            f"{where}: the joint {model.joint(number).name!r} has more than one coordinate",
            cure="springref can be set on hinge and slide joints only",
        )


def _check_motor(model: mujoco.MjModel, number: int, where: str) -> None:
    affine = int(model.actuator_biastype[number]) == mujoco.mjtBias.mjBIAS_AFFINE
    if not affine or model.actuator_gainprm[number, 0] == 0 or model.actuator_biasprm[number, 2] >= 0:
        raise ModelError(
            f"{where}: motor_constant and resistance need an actuator with gain k/R and velocity bias -k^2/R",
            cure='write it as <general gaintype="fixed" gainprm="k/R" biastype="affine" biasprm="0 0 -k^2/R"/>',
        )


def _servo_gain(model: mujoco.MjModel, number: int, where: str, attribute: str) -> ServoGain:
    gain = model.actuator_gainprm[number, 0]
    _, on_length, on_velocity = model.actuator_biasprm[number, :3]
    affine = int(model.actuator_biastype[number]) == mujoco.mjtBias.mjBIAS_AFFINE
    of_position = affine and gain != 0 and on_length == -gain
    of_velocity = affine and gain != 0 and on_length == 0 and on_velocity == -gain
    if not of_position and not (of_velocity and attribute == "kv"):
        servos = "a servo of position" if attribute == "kp" else "a servo of position or of velocity"
        raise ModelError(
            f"{where}: {attribute} is of {servos}, and the actuator {model.actuator(number).name!r} is none",
            cure='write it as <position kp="..." kv="..."/> or <velocity kv="..."/>, or set gain and bias',
        )
    return ServoGain(number, {"kp": 1, "kv": 2}[attribute], attribute == "kp" or of_velocity)


def _check_bias(model: mujoco.MjModel, number: int, where: str) -> None:
    kind = mujoco.mjtBias
    if int(model.actuator_biastype[number]) not in (kind.mjBIAS_NONE, kind.mjBIAS_AFFINE):
        raise ModelError(
            f"{where}: the actuator's bias is not affine, so these numbers mean something else in it",
            cure='make it <general biastype="affine" biasprm="0 0 0" .../>',
        )


def _check_filter(model: mujoco.MjModel, number: int, where: str) -> None:
    kind = mujoco.mjtDyn
    if int(model.actuator_dyntype[number]) not in (kind.mjDYN_FILTER, kind.mjDYN_FILTEREXACT):
        raise ModelError(
            f"{where}: the actuator has no filter, so MuJoCo would ignore its time constant",
            cure='give it dyntype="filterexact" and dynprm="0.01"',
        )


ATTRIBUTES: dict[str, dict[str, Attribute]] = {
    "body": {
        "mass": Attribute(
            "kg",
            "mass of all geoms together; the inertia follows in proportion, the centre of mass stays",
            _own(BodyMass, _check_moves),
            least=0.0,
        ),
        "com_x": Attribute(
            "m", "centre of mass in the body's frame", _field("body_ipos", 0, check=_check_moves)
        ),
        "com_y": Attribute("m", "", _field("body_ipos", 1, check=_check_moves)),
        "com_z": Attribute("m", "", _field("body_ipos", 2, check=_check_moves)),
        "inertia": Attribute(
            "1", "factor on the principal moments of inertia", _own(BodyInertia, _check_moves), least=0.0
        ),
        "inertia_x": Attribute(
            "kg m^2", "principal moment of inertia", _field("body_inertia", 0, check=_check_moves), least=0.0
        ),
        "inertia_y": Attribute("kg m^2", "", _field("body_inertia", 1, check=_check_moves), least=0.0),
        "inertia_z": Attribute("kg m^2", "", _field("body_inertia", 2, check=_check_moves), least=0.0),
    },
    "joint": {
        "damping": Attribute("N s/m or N m s/rad", "viscous damping", _dof_field("dof_damping")),
        "damping_quadratic": Attribute(
            "N s^2/m^2 or N m s^2/rad^2", "coefficient of v|v|", _dof_field("dof_dampingpoly", 0)
        ),
        "damping_cubic": Attribute(
            "N s^3/m^3 or N m s^3/rad^3", "coefficient of v^3", _dof_field("dof_dampingpoly", 1)
        ),
        "frictionloss": Attribute("N or N m", "Coulomb friction", _dof_field("dof_frictionloss"), least=0.0),
        "stiffness": Attribute("N/m or N m/rad", "spring to springref", _field("jnt_stiffness")),
        "stiffness_quadratic": Attribute(
            "N/m^2 or N m/rad^2", "coefficient of x|x|", _field("jnt_stiffnesspoly", 0)
        ),
        "stiffness_cubic": Attribute(
            "N/m^3 or N m/rad^3", "coefficient of x^3", _field("jnt_stiffnesspoly", 1)
        ),
        "springref": Attribute("m or rad", "where the spring is at rest", _springref),
        "armature": Attribute("kg or kg m^2", "reflected inertia", _dof_field("dof_armature"), least=0.0),
    },
    "geom": {
        "size": Attribute("m", "all sizes in proportion; the value is the first one", _size(), least=0.0),
        "size_x": Attribute("m", "first size", _size(0), least=0.0),
        "size_y": Attribute("m", "second size", _size(1), least=0.0),
        "size_z": Attribute("m", "third size", _size(2), least=0.0),
        "friction": Attribute("1", "sliding friction", _field("geom_friction", 0), least=0.0),
        "friction_torsional": Attribute("m", "torsional friction", _field("geom_friction", 1), least=0.0),
        "friction_rolling": Attribute("m", "rolling friction", _field("geom_friction", 2), least=0.0),
        "solref_timeconst": Attribute("s", "contact time constant (or -stiffness)", _field("geom_solref", 0)),
        "solref_dampratio": Attribute("1", "contact damping ratio (or -damping)", _field("geom_solref", 1)),
        "restitution": Attribute(
            "1", "coefficient of restitution, from 0.14 to 1", _own(Restitution), least=0.0
        ),
    },
    "tendon": {
        "damping": Attribute(
            "N s/m, or N m s/rad over hinges alone", "viscous damping", _field("tendon_damping")
        ),
        "frictionloss": Attribute("N or N m", "Coulomb friction", _field("tendon_frictionloss"), least=0.0),
        "stiffness": Attribute(
            "N/m or N m/rad", "spring to the length at which it is at rest", _field("tendon_stiffness")
        ),
    },
    "actuator": {
        "gain": Attribute(
            "N or N m per ctrl",
            "gainprm[0]: the force of a motor or a rotor for a ctrl of 1",
            _field("actuator_gainprm", 0),
        ),
        "kp": Attribute(
            "N/m or N m/rad", "of a servo of position: gain kp, bias -kp on the length", _servo("kp")
        ),
        "kv": Attribute(
            "N s/m or N m s/rad",
            "of a servo: bias -kv on the velocity; of velocity alone, its gain too",
            _servo("kv"),
        ),
        "bias": Attribute("N or N m", "constant force, biasprm[0]", _bias(0)),
        "bias_position": Attribute("N/m or N m/rad", "biasprm[1]", _bias(1)),
        "bias_velocity": Attribute("N s/m or N m s/rad", "biasprm[2]", _bias(2)),
        "gear": Attribute(
            "1 or m",
            "gear[0]; not what turns a rotor at a site, whose gear has six numbers",
            _field("actuator_gear", 0),
        ),
        "time_constant": Attribute(
            "s", "of a filter, dynprm[0]", _field("actuator_dynprm", 0, check=_check_filter), least=0.0
        ),
        "motor_constant": Attribute(
            "N m/A", "k of a motor driven by volts: gain k/R, back-EMF -k^2/R", _motor(0)
        ),
        "resistance": Attribute("ohm", "R of a motor driven by volts", _motor(1), least=0.0),
    },
    "option": {
        "gravity_x": Attribute("m/s^2", "gravity", _option("gravity", 0)),
        "gravity_y": Attribute("m/s^2", "", _option("gravity", 1)),
        "gravity_z": Attribute("m/s^2", "", _option("gravity", 2)),
        "density": Attribute("kg/m^3", "of the medium", _option("density"), least=0.0),
        "viscosity": Attribute("Pa s", "of the medium", _option("viscosity"), least=0.0),
        "wind_x": Attribute("m/s", "velocity of the medium", _option("wind", 0)),
        "wind_y": Attribute("m/s", "", _option("wind", 1)),
        "wind_z": Attribute("m/s", "", _option("wind", 2)),
    },
}
