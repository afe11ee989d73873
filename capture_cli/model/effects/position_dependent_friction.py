"""Dry friction that depends on where a joint is: a rough patch, a bent rail."""

import numpy as np

from capture_cli.model.effects._joint_force import FRICTION, JointForce
from capture_cli.model.parameters import Parameter


def rough_patch(qpos, *, friction, centre, width):
    """Dry friction added: friction exp(-((x - centre) / width)^2 / 2)."""
    return friction * np.exp(-0.5 * np.square((qpos - centre) / width))


class PositionDependentFriction(JointForce):
    """`friction` exp(-((x - `centre`) / `width`)^2 / 2) is added to the joint's dry friction."""

    summary = "a rough patch: more dry friction around one position of a joint"
    shapes = ("centre", "width")
    kernel = staticmethod(rough_patch)
    adds_to = FRICTION

    @property
    def parameters(self):
        middle, travel = self.middle, self.reach
        length = self.unit("m", "rad")
        farthest = 1.5 * travel  # the flank of a patch that the joint does not get to shows, too
        return (
            Parameter("friction", self.unit("N", "N m"), 0.0, self.characteristic_force, 0.0),
            Parameter("centre", length, middle - farthest, middle + farthest, middle),
            Parameter("width", length, 0.02 * self.characteristic_travel, travel, 0.15 * travel),
        )
