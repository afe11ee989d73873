"""Inputs that MuJoCo would clip, and joint positions outside of the range."""

import mujoco
import numpy as np

from capture_cli.common.quantities import percent
from capture_cli.log.checks.base import Check, warning


class Ranges(Check):
    def findings(self, given):
        log, task = given.log, given.task
        model = task.model
        rounded = 1e-6  # of an actuator's range: numbers in files are rounded
        for k, c in enumerate(task.inputs):
            if model.actuator_ctrllimited[c.index]:
                share, low, high = _outside(
                    log.inputs[:, k], model.actuator_ctrlrange[c.index], slack=rounded
                )
                if share:
                    yield warning(
                        f"input {c.name}",
                        f"{percent(share, 1)} of the samples are outside ctrlrange ({low:g}, {high:g}): MuJoCo clips",
                        "widen ctrlrange in the model, or correct scale and offset",
                    )
        sampled = log.sampled
        range_slack = 0.05  # of a joint's range
        for k, c in enumerate(task.outputs):
            joint = int(model.sensor_objid[c.sensor])
            is_position = model.sensor_type[c.sensor] == mujoco.mjtSensor.mjSENS_JOINTPOS
            if is_position and model.jnt_limited[joint]:
                share, low, high = _outside(
                    log.outputs[sampled[:, k], k], model.jnt_range[joint], slack=range_slack
                )
                if share:
                    yield warning(
                        f"output {c.name}",
                        f"{percent(share, 1)} of the samples lie outside the joint's range ({low:g}, {high:g})",
                        "check scale and offset (degrees, another zero?), or the joint's range",
                    )


def _outside(values: np.ndarray, limits: np.ndarray, *, slack: float) -> tuple[float, float, float]:
    """Share of `values` (step,) farther outside `limits` (2,) than `slack` of their span, and the limits."""
    low, high = map(float, limits)
    margin = slack * (high - low)
    if not len(values):
        return 0.0, low, high
    with np.errstate(invalid="ignore"):
        return float(np.mean((values < low - margin) | (values > high + margin))), low, high
