"""A control that is followed like a damped spring: an arm behind an impedance or operational-space controller."""

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.recursive_filter import recursion
from capture_cli.log.windows import SETTINGS as WINDOWS
from capture_cli.model.effects._actuator_effect import ControlTimeEffect
from capture_cli.model.effects._lag import left_behind, second_order_step
from capture_cli.model.parameters import Parameter


@frozen
class SETTINGS:
    forgotten: float = 12.0  # times over which a deviation falls by e: 6e-6 of it is left


class SecondOrderLag:
    """T^2 x'' + 2 damping_ratio T x' + x = control, with T the time_constant; the mean of x over the step.

    The exact solution for a control that is held over each step; its deviation is (x - control, T x').
    """

    def __init__(self, *, time_constant, damping_ratio, timestep):
        self.steps = time_constant / timestep
        self.damping_ratio = damping_ratio
        self.kept, self.rate_kept = second_order_step(time_constant, damping_ratio, timestep)
        self.state = None
        self.rate = 0.0

    def __call__(self, control):
        gap = 0.0 * control if self.state is None else self.state - control
        ahead = self.kept[0] * gap + self.kept[1] * self.rate
        rate = self.rate_kept[0] * gap + self.rate_kept[1] * self.rate
        # the integral of the equation over the step
        mean = self.steps * (self.rate - rate + 2 * self.damping_ratio * (gap - ahead))
        self.state, self.rate = control + ahead, rate
        return control + mean


class ControlSecondOrderLag(ControlTimeEffect):
    """The control arrives through a second-order lag of natural frequency 1 / `time_constant` (rad/s) and of
    `damping_ratio`. It is the mean over a step that arrives.

    For small time constants it is a delay by 2 damping_ratio time_constant.
    """

    summary = "a control arrives through a second-order lag: it is followed like a damped spring"
    shapes = ("damping_ratio",)
    kernel = SecondOrderLag
    remembers = (
        f"{SETTINGS.forgotten:g} time constants of its slower pole, which is `time_constant` / `damping_ratio` where "
        f"the latter is 1 or less; {WINDOWS.lead:g} s at most"
    )
    parameters = (
        Parameter("time_constant", "s", 0.0, 0.3, 0.0),
        Parameter("damping_ratio", "1", 0.3, 1.5, 1.0),
    )

    def at_once(self, told, coefficients, timestep):
        lag = SecondOrderLag(**coefficients, timestep=timestep)
        driven = np.stack([left_behind(told), np.zeros_like(told)], axis=1)
        gap, rate = recursion(np.array([lag.kept, lag.rate_kept]), driven).swapaxes(0, 1)
        ahead, later = (own[0] * gap + own[1] * rate for own in (lag.kept, lag.rate_kept))
        return told + lag.steps * (rate - later + 2 * lag.damping_ratio * (gap - ahead))

    def memory(self, values):
        time_constant, damping_ratio = values.T
        slowest = damping_ratio - np.sqrt(np.maximum(damping_ratio**2 - 1, 0))
        return min(SETTINGS.forgotten * float((time_constant / slowest).max()), WINDOWS.lead)
