"""What a model offers a task: inputs, outputs, sensors that it lacks, and parameters that are worth opening."""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco

from capture_cli.common.frozen import frozen
from capture_cli.model.effects._scales import (
    HINGE,
    SLIDE,
    characteristic_force,
    characteristic_speed,
    driven_joint,
    inertia,
)
from capture_cli.model.quaternion_signs import is_quaternion
from capture_cli.model.sensor_units import reported_unit
from capture_cli.stages.drafting.column_names import AXES, COMMAND, EFFORT, POSITION, VELOCITY, Wanted


@frozen
class SETTINGS:
    # Times the model's own value, or what the joint's weight and inertia suggest, whichever is more: the upper end
    above: float = 5.0
    friction: float = 0.3  # of the joint's characteristic force
    # Times the model's own value, between which a gain is looked for: published ones were 56 times too high (SO-101)
    least_gain: float = 0.005
    most_gain: float = 5.0


_SENSED = {  # by the kind of a sensor of a joint
    int(mujoco.mjtSensor.mjSENS_JOINTPOS): POSITION,
    int(mujoco.mjtSensor.mjSENS_JOINTVEL): VELOCITY,
    int(mujoco.mjtSensor.mjSENS_JOINTACTFRC): EFFORT,
}


@dataclass(frozen=True)
class Channel:
    """An input or output that a task could have. wanted: of each of its values. whole: whether all have to be there,
    as of an attitude. joint: whose sensor the model lacks, None where it has it; role: what that sensor would report.
    """

    name: str
    unit: str
    wanted: tuple[Wanted, ...]
    whole: bool = False
    joint: str | None = None
    role: str | None = None


@dataclass(frozen=True)
class Opened:
    """A parameter that a task could have: its name, what it sets, its unit and bounds."""

    name: str
    target: str
    unit: str
    low: float
    high: float


def inputs_of(model: mujoco.MjModel) -> Iterator[Channel]:
    """Every named actuator of one control that comes without delay."""
    for a in range(model.nactuator):
        name = model.actuator(a).name
        if not name or model.actuator_ctrlnum[a] != 1 or model.actuator_delay[a] > 0:
            continue
        joint = driven_joint(model, a)
        names = (name, model.joint(joint).name) if joint >= 0 else (name,)
        turns = joint >= 0 and model.jnt_type[joint] == HINGE
        _, of_position, of_velocity = model.actuator_biasprm[a, :3]
        servo, plain = joint >= 0, model.actuator_gainprm[a, 0] == model.actuator_gear[a, 0] == 1
        if servo and of_position:
            unit, roles = "rad" if turns else "m", (COMMAND,)
        elif servo and of_velocity:
            unit, roles = "rad/s" if turns else "m/s", (COMMAND, VELOCITY)
        else:
            unit, roles = ("N m" if turns else "N") if servo and plain else "1", (COMMAND, EFFORT)
        yield Channel(name, unit, (Wanted(names, roles),))


def outputs_of(model: mujoco.MjModel) -> Iterator[Channel]:
    """Every named sensor that reports at once, then position and velocity of the joints that have no sensor of it."""
    sensed = set()
    for s in range(model.nsensor):
        kind, name = int(model.sensor_type[s]), model.sensor(s).name
        if not name or model.sensor_history[s, 0] or model.sensor_interval[s].any():
            continue
        names, role = [name], _SENSED.get(kind)
        if role:
            names.append(model.joint(model.sensor_objid[s]).name)
            sensed.add((names[1], role))
        roles, size, whole = (role,) if role else (), int(model.sensor_dim[s]), is_quaternion(model, s)
        axes = "" if size == 1 else AXES[-size:] if size <= len(AXES) else map(str, range(size))
        ends = [f"_{axis}" for axis in axes] or [""]
        wanted = tuple(Wanted(tuple(n + end for n in names), roles, end) for end in ends)
        yield Channel(name, reported_unit(model, s) or "1", wanted, whole)
    for joint in _joints(model):
        name, turns = model.joint(joint).name, model.jnt_type[joint] == HINGE
        for role, unit, ending in (
            (POSITION, "rad" if turns else "m", "_pos"),
            (VELOCITY, "rad/s" if turns else "m/s", "_vel"),
        ):
            if (name, role) not in sensed:
                yield Channel(name + ending, unit, (Wanted((name,), (role,)),), joint=name, role=role)


def parameters_of(model: mujoco.MjModel) -> Iterator[Opened]:
    """Damping, dry friction and armature of each named hinge and slide joint, and gains of position servos."""
    for joint in _joints(model):
        name, dof, turns = model.joint(joint).name, model.jnt_dofadr[joint], model.jnt_type[joint] == HINGE
        force, speed = characteristic_force(model, joint), characteristic_speed(model, joint)
        for attribute, unit, own, usual in (
            ("damping", "N m s/rad" if turns else "N s/m", model.dof_damping[dof], force / speed),
            ("frictionloss", "N m" if turns else "N", model.dof_frictionloss[dof], SETTINGS.friction * force),
            ("armature", "kg m^2" if turns else "kg", model.dof_armature[dof], inertia(model, joint)),
        ):
            high = max(SETTINGS.above * float(own), usual)
            yield Opened(f"{name}_{attribute}", f"joint:{name}:{attribute}", unit, 0.0, high)
    for a in range(model.nactuator):
        name, gain, bias = model.actuator(a).name, model.actuator_gainprm[a, 0], model.actuator_biasprm[a, 1]
        if name and gain > 0 and bias == -gain:
            low, high = SETTINGS.least_gain * float(gain), SETTINGS.most_gain * float(gain)
            yield Opened(f"{name}_kp", f"actuator:{name}:kp", "N m/rad", low, high)


def _joints(model: mujoco.MjModel) -> list[int]:
    return [j for j in range(model.njnt) if model.jnt_type[j] in (HINGE, SLIDE) and model.joint(j).name]
