"""Angles that begin anew after a whole turn."""

import mujoco
import numpy as np

from capture_cli.log.checks.base import Check, warning


class WholeTurns(Check):
    """Angles of hinges that begin anew after a whole turn, as a heading from -180 to 180 degrees does."""

    def findings(self, given):
        log, task = given.log, given.task
        model = task.model
        episode = np.searchsorted(log.episode_ends, np.arange(len(log.time)), side="right")
        turn_slack = 1.0  # rad that a hinge moves between two samples, beside a jump by a turn
        for k, c in enumerate(task.outputs):
            if model.sensor_type[c.sensor] != mujoco.mjtSensor.mjSENS_JOINTPOS:
                continue
            if model.jnt_type[model.sensor_objid[c.sensor]] != mujoco.mjtJoint.mjJNT_HINGE:
                continue
            own = np.flatnonzero(log.sampled[:, k])
            together = episode[own[1:]] == episode[own[:-1]]
            with np.errstate(invalid="ignore"):
                steps = np.abs(np.diff(log.outputs[own, k]))[together]
                jumps = np.abs(steps - 2 * np.pi) < turn_slack
            if jumps.any() and np.median(steps) < turn_slack:
                count = int(jumps.sum())
                yield warning(
                    f"output {c.name}",
                    f"jumps by a whole turn in {count} place{'s' * (count > 1)}, and the angle of a hinge does not",
                    f"write period = {2 * np.pi / abs(c.scale):.6g} under [outputs.{c.name}] and import again",
                )
