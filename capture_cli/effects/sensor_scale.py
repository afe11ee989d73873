"""A sensor that reports too much or too little."""

from __future__ import annotations

from capture_cli.effects._sensor_effect import NumberEffect
from capture_cli.parameters import Parameter


class SensorScale(NumberEffect):
    """The sensor reports (1 + `change`) times what is there."""

    summary = "a sensor reports too much or too little in proportion"

    @property
    def parameters(self):
        return (Parameter("change", "1", -0.2, 0.2, 0.0),)

    def reported(self, series, values, timestep):
        return series * (1 + values[:, None])
