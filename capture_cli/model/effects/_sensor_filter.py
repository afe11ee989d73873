"""What sensors behind a low-pass filter share: what the filter remembers where a simulation begins."""

from typing import ClassVar

import numpy as np

from capture_cli.model.effects._sensor_effect import TimeEffect


class SensorFilter(TimeEffect):
    """A sensor reports through a filter whose first parameter is its `time_constant` (s).

    begins_with: coefficients of the kernel, each a state for each of the sensor's numbers; at 0 of all of them it is as
    if motion before had been even.
    """

    begins_with: ClassVar[tuple[str, ...]]
    states_mean = (
        "`ahead K`: what is reported of its number K, in the sensor's unit, over what it would be had motion before "
        "been even; `rising K`, of second order: the same of its slope times `time_constant`. At 1 what that number "
        "commonly changes within `time_constant`"
    )
    _speeds: np.ndarray | None = None  # per s, of each of its numbers, where a log shows them fastest

    def look_in(self, log):
        super().look_in(log)
        if log.reports is not None:
            self._speeds = log.reports.speeds[self.columns]

    @property
    def states(self):
        return tuple(f"{name} {k}" for name in self.begins_with for k in range(len(self.sizes)))

    def states_sd(self, first):
        if self._speeds is None:
            return super().states_sd(first)
        # as far as the log shows that it goes, in place of what is common
        own = np.where(self._speeds > 0, self._speeds / self.sizes, 1.0)
        return np.tile(own, (len(first), len(self.begins_with)))

    def measure(self, sensors, values, timestep, *, states=None, **_):
        states = np.zeros(len(self.states)) if states is None else states
        count = len(self.begins_with)
        # within that time a signal may go as far as it commonly does in a second
        begun = np.split(values[:, :1] * np.tile(self.sizes, count) * states, count, axis=-1)
        return self.measured(sensors, values, timestep, **dict(zip(self.begins_with, begun, strict=True)))
