"""A control that cannot jump."""

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.model.effects._actuator_effect import UNIT, RememberingEffect
from capture_cli.model.parameters import Parameter


@frozen
class SETTINGS:
    slowest: float = 2.0  # s, from nothing to a full control
    full_change: float = 2.0  # full controls, from one end to the other


class RateLimit:
    """x follows the control by one unit in `slowness` seconds at most; the mean of x over the step."""

    def __init__(self, *, slowness, timestep):
        self.slowness = slowness / timestep  # steps per unit
        self.state = None

    def __call__(self, control):
        before = control if self.state is None else self.state
        gap = control - before
        steps = np.abs(gap) * self.slowness
        moved = gap / np.maximum(steps, 1)
        self.state = np.where(steps <= 1, control, before + moved)
        return np.where(steps <= 1, control - gap * steps / 2, before + moved / 2)


class ControlRateLimit(RememberingEffect):
    """The control needs at least `slowness` (s per unit of the control) to change by one unit; at 0 it can
    jump.

    It is the mean over a step that arrives.
    """

    summary = "a control cannot change faster than at some rate"
    kernel = RateLimit
    remembers = (
        f"`slowness` times {SETTINGS.full_change:g} times the largest control: what it takes from one end to the "
        "other"
    )

    @property
    def parameters(self):
        return (Parameter("slowness", f"s/{UNIT}", 0.0, SETTINGS.slowest / self.scale, 0.0),)

    def memory(self, values):
        return SETTINGS.full_change * self.scale * float(values.max())
