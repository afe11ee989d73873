"""A sensor that reports late."""

import numpy as np

from capture_cli.log.reported_motion import SETTINGS as REPORTED_MOTION
from capture_cli.log.windows import at_times
from capture_cli.model.effects._actuator_effect import (
    CONTROL_BEFORE,
    controls_before,
    single_control_actuators,
)
from capture_cli.model.effects._places import site_id
from capture_cli.model.effects._sensor_effect import TimeEffect
from capture_cli.model.parameters import Parameter


def late(series, *, delay, timestep):
    """What was `delay` seconds ago; before the first row motion is taken to have been even."""
    return at_times(series, np.arange(series.shape[-2])[:, None] - delay / timestep)


class SensorDelay(TimeEffect):
    """The sensor reports what was `delay` (s) ago.

    Of a window inside a log, what it reports first was before the window: the simulation begins so much earlier, with
    the controls of that time. Those before an episode began are states of their own.
    """

    summary = "a sensor reports late"
    states_before = True
    states_mean = CONTROL_BEFORE
    reports_late = True
    kernel = staticmethod(late)
    parameters = (Parameter("delay", "s", 0.0, REPORTED_MOTION.most_late, 0.0),)

    @property
    def states(self):
        return tuple(f"{name} before" for name in single_control_actuators(self.model))

    def before(self, states):
        names = single_control_actuators(self.model)
        return controls_before(self.model, [site_id(self.model, "actuator", n) for n in names], states)

    def lateness(self, values, elapsed=0.0):
        late = np.zeros((len(values), self.model.nsensordata))
        late[:, self.columns] = values
        return late
