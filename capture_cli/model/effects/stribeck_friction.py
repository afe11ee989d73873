"""Dry friction that is larger at rest than in motion."""

import numpy as np

from capture_cli.model.effects._joint_force import FRICTION, JointForce
from capture_cli.model.parameters import Parameter


def stribeck(qvel, *, breakaway, speed):
    """Dry friction added: breakaway exp(-(v / speed)^2)."""
    return breakaway * np.exp(-np.square(qvel / speed))


class StribeckFriction(JointForce):
    """`breakaway` exp(-(v / `speed`)^2) is added to the joint's dry friction."""

    summary = "dry friction that is larger at rest than in motion: stick-slip"
    shapes = ("speed",)
    kernel = staticmethod(stribeck)
    adds_to = FRICTION

    @property
    def parameters(self):
        fast = self.characteristic_speed
        # in a log to where nine tenths are left at its fastest, which dry friction of one size is hardly told from
        highest = 3.0 if self.seen else 0.5
        return (
            Parameter("breakaway", self.unit("N", "N m"), 0.0, self.characteristic_force, 0.0),
            Parameter("speed", self.unit("m/s", "rad/s"), 2e-3 * fast, highest * fast, 0.03 * fast),
        )
