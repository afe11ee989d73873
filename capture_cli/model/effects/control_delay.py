"""A control that arrives late."""

import numpy as np

from capture_cli.model.effects._actuator_effect import ControlTimeEffect
from capture_cli.model.parameters import Parameter


class Delay:
    """What was `delay` seconds ago; of a part of a step, the mean over the step. It begins with the first control."""

    def __init__(self, *, delay, timestep):
        late = np.atleast_1d(delay) / timestep
        self.whole = np.floor(late).astype(int)
        self.part = late - self.whole
        self.past = None  # a ring of the last controls, (step, ...)
        self.step = 0

    def __call__(self, control):
        size = self.whole.max() + 2
        if self.past is None:
            self.past = np.repeat(control[None], size, axis=0)
        self.past[self.step % size] = control
        row, late = np.arange(len(self.whole)), self.step - self.whole
        now, before = self.past[late % size, row], self.past[(late - 1) % size, row]
        self.step += 1
        return now + self.part * (before - now)


class ControlDelay(ControlTimeEffect):
    """The control arrives `delay` (s) late. Of a part of a step it is the mean over the step that arrives."""

    summary = "a control arrives late"
    kernel = Delay
    remembers = "`delay`"
    parameters = (Parameter("delay", "s", 0.0, 0.5, 0.0),)  # what a busy network takes

    def arrived(self, told, coefficients, timestep):
        delay = Delay(**coefficients, timestep=timestep)
        step, row = np.ogrid[: len(told), : told.shape[1]]
        now, before = (told[np.maximum(step - delay.whole - late, 0), row] for late in range(2))
        return now + delay.part * (before - now)

    def memory(self, values):
        return float(values.max())
