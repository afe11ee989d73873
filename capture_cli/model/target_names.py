"""How targets are written, KIND:NAME:ATTRIBUTE ("joint:x:damping"): what there is, and what a model has of it."""

import mujoco

from capture_cli.errors import ModelError, did_you_mean
from capture_cli.model.target_attributes import ATTRIBUTES, Attribute
from capture_cli.model.targets import Target


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
    number = -1 if kind == "option" else object_id(model, kind, name, f"{where}: {text!r}")
    return ATTRIBUTES[kind][attribute].target(model, number, where)


def attribute_of(text: str) -> Attribute:
    """What the target `text` of a model sets."""
    kind, _, attribute = split_target(text)
    return ATTRIBUTES[kind][attribute]


def split_target(text: str) -> tuple[str, str, str]:
    """Kind, name and attribute of a target, "" where it lacks one. The name itself may hold colons."""
    kind, _, rest = text.partition(":")
    name, _, attribute = rest.rpartition(":")
    return kind, name, attribute


def object_id(model: mujoco.MjModel, kind: str, name: str, where: str) -> int:
    """The id of a body, joint, geom, tendon or actuator. Raises ModelError naming those that exist."""
    number = mujoco.mj_name2id(model, mujoco.mju_str2Type(kind), name)
    if number < 0:
        raise ModelError(
            f"{where}: the model has no {kind} {name!r}", cure=did_you_mean(name, object_names(model, kind))
        )
    return number


def object_names(model: mujoco.MjModel, kind: str) -> list[str]:
    """Names of the model's bodies, joints, geoms, tendons or actuators, those that have one."""
    counts = {"body": model.nbody, "joint": model.njnt, "geom": model.ngeom, "tendon": model.ntendon}
    count = counts.get(kind, model.nactuator)
    names = (mujoco.mj_id2name(model, mujoco.mju_str2Type(kind), i) for i in range(count))
    return [n for n in names if n]
