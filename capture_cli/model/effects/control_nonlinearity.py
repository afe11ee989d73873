"""A drive whose force does not grow in proportion to its control."""

import numpy as np

from capture_cli.model.effects._actuator_effect import UNIT, ActuatorEffect, without_target
from capture_cli.model.parameters import Parameter

SMALLEST = 0.1  # of 1 + bend u^2: where controls larger than the largest would have no square root


def curved(control, *, bend):
    """u / sqrt(1 + bend u^2)."""
    return control / np.sqrt(np.maximum(1 + bend * control**2, SMALLEST))


class ControlNonlinearity(ActuatorEffect):
    """Controls u arrive as u / sqrt(1 + `bend` u^2): iron that saturates, an amplifier at its end; of negative `bend`
    larger than modelled, a valve that opens ever wider.

    Small controls arrive as they are. Targets of servos are not among its sites.
    """

    summary = "a control arrives the smaller, in proportion, the larger it is: a motor's iron saturates"
    where = "every actuator whose control is no target of a servo"
    kernel = staticmethod(curved)

    @classmethod
    def sites(cls, model):
        return without_target(model)

    @property
    def parameters(self):
        square = self.scale**2
        # Of what the largest control gives: at the ends of the range it arrives half as large, or 1.4 times
        least = -0.5
        most = 3.0
        return (Parameter("bend", f"1/{UNIT}^2", least / square, most / square, 0.0),)
