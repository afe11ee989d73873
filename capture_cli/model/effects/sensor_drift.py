"""A sensor whose offset grows while the machine runs."""

import numpy as np

from capture_cli.model.effects._sensor_effect import NumberEffect


def drifted(series, *, rate, timestep, elapsed=0.0):
    """series + rate t, with t since the episode began, which was `elapsed` s before the first row."""
    return series + rate * (elapsed + timestep * np.arange(series.shape[-2])[:, None])


class SensorDrift(NumberEffect):
    """An offset of each of the sensor's numbers that is none when an episode begins and grows by `rate`, or `x`, `y`
    and `z`, per second: a gyro or a load cell that warms.
    """

    summary = "a sensor's offset grows while the machine runs"
    number_by_number = True
    kernel = staticmethod(drifted)

    @property
    def parameters(self):
        usual = 20.0  # s, that an episode takes where no log says
        largest = 0.6 / (self.longest or usual)  # of the size that its values commonly have, over an episode
        return self.for_each("rate", f"{self.quantity.unit}/s", largest * self.quantity.size)

    def coefficients(self, values):
        return {"rate": self.of_all(values)}

    def measure(self, sensors, values, timestep, *, elapsed=0.0, **_):
        begin = np.broadcast_to(elapsed, len(values))[:, None]
        return self.measured(sensors, values, timestep, elapsed=begin)

    def true_motion(self, derivatives, values, elapsed=0.0):
        true, values = derivatives.copy(), self.of_all(values)
        true[:, 0, self.columns] -= values * np.reshape(elapsed, (-1, 1))
        true[:, 1, self.columns] -= values
        return true
