"""Angles in degrees that are read as radians, and signs that go against each other."""

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np

from capture_cli.log.checks.base import Check, warning
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks.base import Channel, Task

DEGREES = 180 / np.pi


class Degrees(Check):
    """Angles of hinges that are 57.3 times, or a 57.3th of, what another channel says of the same motion; or go against
    it."""

    def findings(self, given):
        log, task = given.log, given.task
        like_degrees = 0.1  # of that factor, is how near to it the one between two channels is
        correlated = 0.95  # correlation of two channels that show the same motion
        for k, c, joint in _hinge_outputs(task, mujoco.mjtSensor.mjSENS_JOINTPOS):
            angle = log.outputs[:, k]
            others = [
                (f"output {o.name}", "the integral of ", _integral(log.outputs[:, i], log))
                for i, o, of in _hinge_outputs(task, mujoco.mjtSensor.mjSENS_JOINTVEL)
                if of == joint
            ]
            others += [
                (f"input {i.name}", "", log.inputs[:, n])
                for n, i in enumerate(task.inputs)
                if _follows(task.model, i.index, joint)
            ]
            for name, how, reference in others:
                likeness, factor = _likeness(angle, reference, log.episodes)
                if likeness < -correlated:
                    yield warning(
                        f"output {c.name}",
                        f"goes down where {how}{name} goes up: does one of them count the other way?",
                        "write a negative scale under the one that does, and import again",
                    )
                if (
                    abs(likeness) < correlated
                    or min(abs(factor * DEGREES - 1), abs(factor / DEGREES - 1)) > like_degrees
                ):
                    continue
                large, small = (f"output {c.name}", name) if factor > 1 else (name, f"output {c.name}")
                degrees = "deg/s" if how and large == name else "deg"
                yield warning(
                    f"output {c.name}",
                    f"moves {factor:.3g} times as far as {how}{name} says: is {large} in degrees, and {small} in rad?",
                    f'write column_unit = "{degrees}" under {large}, as the model is in rad, and import again',
                )


def _hinge_outputs(task: Task, kind: mujoco.mjtSensor) -> Iterator[tuple[int, Channel, int]]:
    """Outputs of sensors of `kind` at hinges: which, the channel, and the joint."""
    model = task.model
    for k, c in enumerate(task.outputs):
        joint = int(model.sensor_objid[c.sensor])
        if model.sensor_type[c.sensor] == kind and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
            yield k, c, joint


def _follows(model: mujoco.MjModel, actuator: int, joint: int) -> bool:
    """Whether the actuator is a servo that brings the joint to where its control says."""
    at_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
    gain, back = model.actuator_gainprm[actuator, 0], model.actuator_biasprm[actuator, 1]
    return bool(
        at_joint
        and model.actuator_trnid[actuator, 0] == joint
        and model.actuator_gear[actuator, 0] == 1
        and gain == -back != 0
    )


def _integral(speed: np.ndarray, log: MeasuredLog) -> np.ndarray:
    """Of an output (step,) over the time of each episode, by trapezoids."""
    grown = np.zeros(len(speed))
    for e in log.episodes:
        grown[e][1:] = np.cumsum(np.diff(log.time[e]) * (speed[e][1:] + speed[e][:-1]) / 2)
    return grown


def _likeness(values: np.ndarray, reference: np.ndarray, episodes: Sequence[slice]) -> tuple[float, float]:
    """Correlation of `values` (step,) with `reference` within episodes, and how many times as far they go.

    0 and 1 where samples lack or nothing moves.
    """
    both = np.stack([values, reference])
    moves = np.concatenate([both[:, e] - both[:, e].mean(axis=1, keepdims=True) for e in episodes], axis=1)
    with np.errstate(invalid="ignore", over="ignore"):
        (own, cross), (_, theirs) = moves @ moves.T
    if not (np.isfinite([own, cross, theirs]).all() and own > 0 and theirs > 0):
        return 0.0, 1.0
    return float(cross / np.sqrt(own) / np.sqrt(theirs)), float(np.sqrt(own / theirs))
