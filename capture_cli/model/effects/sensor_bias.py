"""A sensor with an offset."""

from capture_cli.model.effects._sensor_effect import NumberEffect


def offset_readings(series, *, offset):
    """series + offset, which is one number or one for each column."""
    return series + offset


class SensorBias(NumberEffect):
    """An offset, in the sensor's unit, of each of its numbers: `offset`, or `x`, `y` and `z`."""

    summary = "a sensor reports with an offset"
    number_by_number = True
    kernel = staticmethod(offset_readings)

    @property
    def parameters(self):
        return self.for_each("offset", self.quantity.unit, self.quantity.size)

    def coefficients(self, values):
        return {"offset": self.of_all(values)}

    def undone(self, derivatives, values):
        true = derivatives.copy()
        true[:, 0] -= self.of_all(values)
        return true
