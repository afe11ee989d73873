"""A spring that is there on one side of a position: a bumper, a cable that goes taut, a soft end stop."""

import numpy as np

from capture_cli.model.effects._joint_force import JointForce
from capture_cli.model.parameters import Parameter


def one_sided(qpos, *, above, below, position):
    """Joint force: -above (x - position) beyond the position, below (position - x) before it."""
    return below * np.maximum(position - qpos, 0.0) - above * np.maximum(qpos - position, 0.0)


class OneSidedSpring(JointForce):
    """A spring of stiffness `above` (N/m or N m/rad) where the joint is beyond `position` (m or rad), and one of
    `below` where it is before it.
    """

    summary = "a spring on one side of a position: a bumper, a taut cable, a soft end stop"
    shapes = ("position",)
    kernel = staticmethod(one_sided)

    @property
    def parameters(self):
        high, middle = 20 * self.characteristic_force / self.characteristic_travel, self.middle
        reach, unit = self.reach, self.unit("N/m", "N m/rad")
        return (
            Parameter("above", unit, 0.0, high, 0.0),
            Parameter("below", unit, 0.0, high, 0.0),
            Parameter("position", self.unit("m", "rad"), middle - reach, middle + reach, middle),
        )
