"""How targets are written, KIND:NAME:ATTRIBUTE ("joint:x:damping"): what there is, and what a model has of it."""

from __future__ import annotations

import mujoco

from capture_cli.errors import ModelError, did_you_mean
from capture_cli.sim.targets import (
    ActuatorBias,
    BodyInertia,
    BodyMass,
    FieldTarget,
    GeomSize,
    MotorConstant,
    MotorResistance,
    Restitution,
    ServoGain,
    Target,
)

_KINDS = {
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "joint": mujoco.mjtObj.mjOBJ_JOINT,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "tendon": mujoco.mjtObj.mjOBJ_TENDON,
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
}

ATTRIBUTES = {
    "body": {
        "mass": (
            "kg",
            "mass of all geoms together; the inertia follows in proportion, the centre of mass stays",
        ),
        "com_x": ("m", "centre of mass in the body's frame"),
        "com_y": ("m", ""),
        "com_z": ("m", ""),
        "inertia": ("1", "factor on the principal moments of inertia"),
        "inertia_x": ("kg m^2", "principal moment of inertia"),
        "inertia_y": ("kg m^2", ""),
        "inertia_z": ("kg m^2", ""),
    },
    "joint": {
        "damping": ("N s/m or N m s/rad", "viscous damping"),
        "damping_quadratic": ("N s^2/m^2 or N m s^2/rad^2", "coefficient of v|v|"),
        "damping_cubic": ("N s^3/m^3 or N m s^3/rad^3", "coefficient of v^3"),
        "frictionloss": ("N or N m", "Coulomb friction"),
        "stiffness": ("N/m or N m/rad", "spring to springref"),
        "stiffness_quadratic": ("N/m^2 or N m/rad^2", "coefficient of x|x|"),
        "stiffness_cubic": ("N/m^3 or N m/rad^3", "coefficient of x^3"),
        "springref": ("m or rad", "where the spring is at rest"),
        "armature": ("kg or kg m^2", "reflected inertia"),
    },
    "geom": {
        "size": ("m", "all sizes in proportion; the value is the first one"),
        "size_x": ("m", "first size"),
        "size_y": ("m", "second size"),
        "size_z": ("m", "third size"),
        "friction": ("1", "sliding friction"),
        "friction_torsional": ("m", "torsional friction"),
        "friction_rolling": ("m", "rolling friction"),
        "solref_timeconst": ("s", "contact time constant (or -stiffness)"),
        "solref_dampratio": ("1", "contact damping ratio (or -damping)"),
        "restitution": ("1", "coefficient of restitution, from 0.14 to 1"),
    },
    "tendon": {
        "damping": ("N s/m, or N m s/rad over hinges alone", "viscous damping"),
        "frictionloss": ("N or N m", "Coulomb friction"),
        "stiffness": ("N/m or N m/rad", "spring to the length at which it is at rest"),
    },
    "actuator": {
        "gain": ("N or N m per ctrl", "gainprm[0]: the force of a motor or a rotor for a ctrl of 1"),
        "kp": ("N/m or N m/rad", "of a servo of position: gain kp, bias -kp on the length"),
        "kv": ("N s/m or N m s/rad", "of a servo: bias -kv on the velocity; of velocity alone, its gain too"),
        "bias": ("N or N m", "constant force, biasprm[0]"),
        "bias_position": ("N/m or N m/rad", "biasprm[1]"),
        "bias_velocity": ("N s/m or N m s/rad", "biasprm[2]"),
        "gear": ("1 or m", "gear[0]; not what turns a rotor at a site, whose gear has six numbers"),
        "time_constant": ("s", "of a filter, dynprm[0]"),
        "motor_constant": ("N m/A", "k of a motor driven by volts: gain k/R, back-EMF -k^2/R"),
        "resistance": ("ohm", "R of a motor driven by volts"),
    },
    "option": {
        "gravity_x": ("m/s^2", "gravity"),
        "gravity_y": ("m/s^2", ""),
        "gravity_z": ("m/s^2", ""),
        "density": ("kg/m^3", "of the medium"),
        "viscosity": ("Pa s", "of the medium"),
        "wind_x": ("m/s", "velocity of the medium"),
        "wind_y": ("m/s", ""),
        "wind_z": ("m/s", ""),
    },
}

_FIELDS = {
    "body:com_x": ("body_ipos", 0),
    "body:com_y": ("body_ipos", 1),
    "body:com_z": ("body_ipos", 2),
    "body:inertia_x": ("body_inertia", 0),
    "body:inertia_y": ("body_inertia", 1),
    "body:inertia_z": ("body_inertia", 2),
    "joint:damping": ("dof_damping", None),
    "joint:damping_quadratic": ("dof_dampingpoly", 0),
    "joint:damping_cubic": ("dof_dampingpoly", 1),
    "joint:frictionloss": ("dof_frictionloss", None),
    "joint:armature": ("dof_armature", None),
    "joint:stiffness": ("jnt_stiffness", None),
    "joint:stiffness_quadratic": ("jnt_stiffnesspoly", 0),
    "joint:stiffness_cubic": ("jnt_stiffnesspoly", 1),
    "joint:springref": ("qpos_spring", None),
    "geom:friction": ("geom_friction", 0),
    "geom:friction_torsional": ("geom_friction", 1),
    "geom:friction_rolling": ("geom_friction", 2),
    "geom:solref_timeconst": ("geom_solref", 0),
    "geom:solref_dampratio": ("geom_solref", 1),
    "tendon:damping": ("tendon_damping", None),
    "tendon:frictionloss": ("tendon_frictionloss", None),
    "tendon:stiffness": ("tendon_stiffness", None),
    "actuator:gain": ("actuator_gainprm", 0),
    "actuator:gear": ("actuator_gear", 0),
    "actuator:time_constant": ("actuator_dynprm", 0),
}
_SPECIAL = {
    "body:mass": BodyMass,
    "body:inertia": BodyInertia,
    "geom:restitution": Restitution,
    "actuator:motor_constant": MotorConstant,
    "actuator:resistance": MotorResistance,
}
_VECTOR = {"x": 0, "y": 1, "z": 2}


def parse_target(text: str, model: mujoco.MjModel, where: str) -> Target:
    """The target written `text`; `where` says where it was written, for the error.

    Raises ModelError naming the kinds, names or attributes that do exist.
    """
    kind, name, attribute = split_target(text)
    if kind not in ATTRIBUTES:
        raise ModelError(f"{where}: unknown kind of target in {text!r}", cure=did_you_mean(kind, ATTRIBUTES))
    form = "option:ATTRIBUTE" if kind == "option" else f"{kind}:NAME:ATTRIBUTE"
    if not attribute or bool(name) != (kind != "option"):
        raise ModelError(f"{where}: {text!r} is not of the form {form}", cure=f'write it as "{form}"')
    if attribute not in ATTRIBUTES[kind]:
        raise ModelError(
            f"{where}: a {kind} has no settable attribute {attribute!r}",
            cure=did_you_mean(attribute, ATTRIBUTES[kind]),
        )
    if kind == "option":
        return _option(attribute)
    return _named(kind, object_id(model, kind, name, f"{where}: {text!r}"), attribute, model, where)


def split_target(text: str) -> tuple[str, str, str]:
    """Kind, name and attribute of a target, "" where it lacks one. The name itself may hold colons."""
    kind, _, rest = text.partition(":")
    name, _, attribute = rest.rpartition(":")
    return kind, name, attribute


def object_id(model: mujoco.MjModel, kind: str, name: str, where: str) -> int:
    """The id of a body, joint, geom, tendon or actuator. Raises ModelError naming those that exist."""
    number = mujoco.mj_name2id(model, _KINDS[kind], name)
    if number < 0:
        raise ModelError(
            f"{where}: the model has no {kind} {name!r}", cure=did_you_mean(name, object_names(model, kind))
        )
    return number


def object_names(model: mujoco.MjModel, kind: str) -> list[str]:
    """Names of the model's bodies, joints, geoms, tendons or actuators, those that have one."""
    counts = {"body": model.nbody, "joint": model.njnt, "geom": model.ngeom, "tendon": model.ntendon}
    count = counts.get(kind, model.nactuator)
    names = (mujoco.mj_id2name(model, _KINDS[kind], i) for i in range(count))
    return [n for n in names if n]


def _option(attribute: str) -> Target:
    field, _, axis = attribute.partition("_")
    return FieldTarget(f"opt.{field}", (_VECTOR[axis],) if axis else ())


def _named(kind: str, number: int, attribute: str, model: mujoco.MjModel, where: str) -> Target:
    key = f"{kind}:{attribute}"
    if attribute.startswith("size"):
        return _geom_size(number, attribute, model, where)
    if attribute in ("motor_constant", "resistance"):
        _check_motor(number, model, where)
    elif attribute in ("kp", "kv"):
        return _servo_gain(number, attribute, model, where)
    elif kind == "actuator" and attribute.startswith("bias"):
        _check_bias(number, model, where)
        return ActuatorBias(number, {"bias": 0, "bias_position": 1, "bias_velocity": 2}[attribute])
    elif attribute == "time_constant":
        _check_filter(number, model, where)
    elif attribute == "springref":
        _check_scalar(number, model, where)
    if key in _SPECIAL:
        return _SPECIAL[key](number)
    field, column = _FIELDS[key]
    index = (number,)
    if field.startswith("dof_"):
        first = model.jnt_dofadr[number]
        index = (slice(first, first + _dofs(model, number)),)
    elif field == "qpos_spring":
        index = (model.jnt_qposadr[number],)
    return FieldTarget(field, index if column is None else (*index, column))


def _dofs(model: mujoco.MjModel, joint: int) -> int:
    kind = mujoco.mjtJoint
    return {int(kind.mjJNT_FREE): 6, int(kind.mjJNT_BALL): 3}.get(int(model.jnt_type[joint]), 1)


def _geom_size(number: int, attribute: str, model: mujoco.MjModel, where: str) -> Target:
    geom = mujoco.mjtGeom
    sizes = {
        int(geom.mjGEOM_SPHERE): 1,
        int(geom.mjGEOM_CAPSULE): 2,
        int(geom.mjGEOM_CYLINDER): 2,
        int(geom.mjGEOM_ELLIPSOID): 3,
        int(geom.mjGEOM_BOX): 3,
    }.get(int(model.geom_type[number]), 0)
    column = _VECTOR.get(attribute.removeprefix("size_"))
    if sizes == 0 or (column is not None and column >= sizes):
        raise ModelError(
            f"{where}: this geom has {sizes} settable sizes, and {attribute!r} is not one of them",
            cure="sizes can be set for spheres (x), capsules and cylinders (x, y), ellipsoids and boxes (x, y, z)",
        )
    return GeomSize(number, (slice(None),) if column is None else (column,))


def _check_scalar(number: int, model: mujoco.MjModel, where: str) -> None:
    kind = mujoco.mjtJoint
    if int(model.jnt_type[number]) not in (kind.mjJNT_HINGE, kind.mjJNT_SLIDE):
        raise ModelError(
            f"{where}: the joint {model.joint(number).name!r} has more than one coordinate",
            cure="springref can be set on hinge and slide joints only",
        )


def _check_motor(number: int, model: mujoco.MjModel, where: str) -> None:
    affine = int(model.actuator_biastype[number]) == mujoco.mjtBias.mjBIAS_AFFINE
    if not affine or model.actuator_gainprm[number, 0] == 0 or model.actuator_biasprm[number, 2] >= 0:
        raise ModelError(
            f"{where}: motor_constant and resistance need an actuator with gain k/R and velocity bias -k^2/R",
            cure='write it as <general gaintype="fixed" gainprm="k/R" biastype="affine" biasprm="0 0 -k^2/R"/>',
        )


def _servo_gain(number: int, attribute: str, model: mujoco.MjModel, where: str) -> ServoGain:
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


def _check_bias(number: int, model: mujoco.MjModel, where: str) -> None:
    kind = mujoco.mjtBias
    if int(model.actuator_biastype[number]) not in (kind.mjBIAS_NONE, kind.mjBIAS_AFFINE):
        raise ModelError(
            f"{where}: the actuator's bias is not affine, so these numbers mean something else in it",
            cure='make it <general biastype="affine" biasprm="0 0 0" .../>',
        )


def _check_filter(number: int, model: mujoco.MjModel, where: str) -> None:
    kind = mujoco.mjtDyn
    if int(model.actuator_dyntype[number]) not in (kind.mjDYN_FILTER, kind.mjDYN_FILTEREXACT):
        raise ModelError(
            f"{where}: the actuator has no filter, so MuJoCo would ignore its time constant",
            cure='give it dyntype="filterexact" and dynprm="0.01"',
        )
