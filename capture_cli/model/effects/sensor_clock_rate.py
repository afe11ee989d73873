"""A logger whose clock does not keep time."""

from capture_cli.log.windows import SETTINGS as WINDOWS
from capture_cli.model.effects._clock import off_clock, on_time
from capture_cli.model.effects._sensor_effect import TimeEffect
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.parameters import Parameter


class SensorClockRate(TimeEffect):
    """In one second of the sensors' clock (1 + `error`) s went by, counted from the start of the episode.

    The controls keep the model's time. A simulation that begins inside an episode begins with the controls of the
    moment that the sensors show, and goes on from there.
    """

    summary = "the sensors' clock runs slow or fast"
    where = "the sensors together"
    kernel = staticmethod(off_clock)

    @classmethod
    def sites(cls, model):
        return [GLOBAL] if model.nsensordata else []

    @property
    def parameters(self):
        # a window has inputs of lead around it: what moves it farther away cannot be simulated
        most = min(WINDOWS.most_drift, WINDOWS.lead / self.longest) if self.longest else WINDOWS.most_drift
        return (Parameter("error", "1", -most, most, 0.0),)

    def drift(self, values, elapsed):
        return values[:, 0] * elapsed

    def undone(self, derivatives, values):
        return on_time(derivatives, error=values)
