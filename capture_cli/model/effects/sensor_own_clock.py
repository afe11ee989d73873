"""A sensor, or a device of several, that stamps what it reports by a clock of its own."""

import mujoco
import numpy as np

from capture_cli.log.reported_motion import SETTINGS as REPORTED_MOTION
from capture_cli.log.windows import SETTINGS as WINDOWS
from capture_cli.model.effects._clock import off_clock, on_time
from capture_cli.model.effects._places import site_id
from capture_cli.model.effects._sensor_effect import SensorEffect, columns_of, columns_source, devices
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.object_names import object_name
from capture_cli.model.parameters import Parameter


class SensorOwnClock(SensorEffect):
    """In one second of the sensor's clock (1 + `error`) s went by, counted from the start of the episode, where the
    other sensors and the controls agree.

    So what it reports comes the later, or the earlier, the longer the episode: a device that counts its own samples.
    Sensors at one site of the model are one device, SENSOR+SENSOR.
    """

    summary = "the clock of one sensor, or of one device, runs slow or fast against all others"
    where = "every sensor, and the sensors of a site together, where there are others"
    reports_late = True
    kernel = staticmethod(off_clock)

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.sensors = devices(model).get(site) or [site_id(model, "sensor", site)]

    @classmethod
    def sites(cls, model):
        single = super().sites(model)
        several = [name for name, sensors in devices(model).items() if len(sensors) < model.nsensor]
        return [*single, *several] if model.nsensor > 1 else []

    @property
    def columns(self):
        return np.r_[*(columns_of(self.model, s) for s in self.sensors)].tolist()

    @property
    def columns_source(self):
        names = (object_name(self.model, "sensor", s) for s in self.sensors)
        return f"np.concatenate([{', '.join(columns_source(self.model, name) for name in names)}])"

    @property
    def parameters(self):
        # what is later than most_late cannot be simulated
        most = (
            min(WINDOWS.most_drift, REPORTED_MOTION.most_late / self.longest)
            if self.longest
            else WINDOWS.most_drift
        )
        return (Parameter("error", "1", -most, most, 0.0),)

    def measure(self, sensors, values, timestep, *, elapsed=0.0, **_):
        steps = np.broadcast_to(np.asarray(elapsed) / timestep, len(values))
        return self.measured(sensors, values, timestep, elapsed_steps=steps[:, None])

    def lateness(self, values, elapsed=0.0):
        late = np.zeros((len(values), self.model.nsensordata))
        late[:, self.columns] = -values * np.reshape(elapsed, (-1, 1))
        return late

    def undone(self, derivatives, values):
        return on_time(derivatives, error=values)
