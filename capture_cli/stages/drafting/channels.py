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
from capture_cli.model.tasks.mjcf_file import endings
from capture_cli.stages.drafting.column_names import COMMAND, EFFORT, POSITION, VELOCITY, Wanted


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
        if joint < 0:
            yield Channel(name, "1", (Wanted((name,), (COMMAND, EFFORT)),))
            continue
        travel, force = _units(model, joint)
        _, of_position, of_velocity = model.actuator_biasprm[a, :3]
        if of_position:
            unit, roles = travel, (COMMAND,)
        elif of_velocity:
            unit, roles = f"{travel}/s", (COMMAND, VELOCITY)
        else:
            is_force = model.actuator_gainprm[a, 0] == model.actuator_gear[a, 0] == 1
            unit, roles = force if is_force else "1", (COMMAND, EFFORT)
        yield Channel(name, unit, (Wanted((name, model.joint(joint).name), roles),))


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
        wanted = tuple(Wanted(tuple(n + end for n in names), roles, end) for end in endings(size))
        yield Channel(name, reported_unit(model, s) or "1", wanted, whole)
    for joint in _joints(model):
        name, (travel, _) = model.joint(joint).name, _units(model, joint)
        for role, unit, ending in ((POSITION, travel, "_pos"), (VELOCITY, f"{travel}/s", "_vel")):
            if (name, role) not in sensed:
                yield Channel(name + ending, unit, (Wanted((name,), (role,)),), joint=name, role=role)


def parameters_of(model: mujoco.MjModel) -> Iterator[Opened]:
    """Damping, dry friction and armature of each named hinge and slide joint, and gains of position servos."""
    for joint in _joints(model):
        name, dof, (travel, force) = model.joint(joint).name, model.jnt_dofadr[joint], _units(model, joint)
        most, speed = characteristic_force(model, joint), characteristic_speed(model, joint)
        mass = "kg m^2" if model.jnt_type[joint] == HINGE else "kg"
        for attribute, unit, own, usual in (
            ("damping", f"{force} s/{travel}", model.dof_damping[dof], most / speed),
            ("frictionloss", force, model.dof_frictionloss[dof], SETTINGS.friction * most),
            ("armature", mass, model.dof_armature[dof], inertia(model, joint)),
        ):
            high = max(SETTINGS.above * float(own), usual)
            yield Opened(f"{name}_{attribute}", f"joint:{name}:{attribute}", unit, 0.0, high)
    for a in range(model.nactuator):
        name, gain, bias = model.actuator(a).name, model.actuator_gainprm[a, 0], model.actuator_biasprm[a, 1]
        if name and gain > 0 and bias == -gain:
            low, high = SETTINGS.least_gain * float(gain), SETTINGS.most_gain * float(gain)
            joint = driven_joint(model, a)
            travel, force = _units(model, joint) if joint >= 0 else ("m", "N")  # of a tendon, its length
            yield Opened(f"{name}_kp", f"actuator:{name}:kp", f"{force}/{travel}", low, high)


def _units(model: mujoco.MjModel, joint: int) -> tuple[str, str]:
    """Of the travel of a hinge or slide joint, and of the force on it."""
    return ("rad", "N m") if model.jnt_type[joint] == HINGE else ("m", "N")


def _joints(model: mujoco.MjModel) -> list[int]:
    return [j for j in range(model.njnt) if model.jnt_type[j] in (HINGE, SLIDE) and model.joint(j).name]
