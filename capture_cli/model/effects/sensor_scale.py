"""A sensor that reports too much or too little."""

from capture_cli.model.effects._sensor_effect import NumberEffect
from capture_cli.model.parameters import Parameter


def rescaled(series, *, change):
    """series (1 + change)."""
    return series * (1 + change)


class SensorScale(NumberEffect):
    """The sensor reports (1 + `change`) times what is there."""

    summary = "a sensor reports too much or too little in proportion"
    kernel = staticmethod(rescaled)
    # from a quarter of what is there, as of other sensors whose reading is undone, to three times
    parameters = (Parameter("change", "1", -0.75, 2.0, 0.0),)

    def undone(self, derivatives, values):
        return derivatives / (1 + values[:, None])
