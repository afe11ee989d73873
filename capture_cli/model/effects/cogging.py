"""A force that repeats with position: a motor's cogging, a gear's teeth."""

from capture_cli.model.effects._periodic_force import AlongPosition
from capture_cli.model.parameters import Parameter


class Cogging(AlongPosition):
    """The joint force `sine` sin(2 pi q / `period`) + `cosine` cos(2 pi q / `period`), q (m or rad) the joint's
    position; it stores and gives back energy.
    """

    summary = "a force that repeats with position: magnets or teeth"

    @property
    def parameters(self):
        high, unit = self.characteristic_force, self.unit("N", "N m")
        return (
            Parameter("sine", unit, -high, high, 0.0),
            Parameter("cosine", unit, -high, high, 0.0),
            self.period,
        )
