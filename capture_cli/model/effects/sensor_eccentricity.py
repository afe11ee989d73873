"""An angle encoder whose disc or magnet is not centred on its axis, or leans."""

import mujoco
import numpy as np

from capture_cli.model.effects._scales import HINGE
from capture_cli.model.effects._sensor_effect import SensorEffect
from capture_cli.model.object_names import object_name
from capture_cli.model.parameters import Parameter


def eccentric(series, *, sine, cosine, sine_twice, cosine_twice):
    """series + sine sin(x) + cosine cos(x) + sine_twice sin(2 x) + cosine_twice cos(2 x), with x the angle."""
    once = sine * np.sin(series) + cosine * np.cos(series)
    return series + once + sine_twice * np.sin(2 * series) + cosine_twice * np.cos(2 * series)


class SensorEccentricity(SensorEffect):
    """At the angle q it reports q + `sine` sin q + `cosine` cos q + `sine_twice` sin 2q + `cosine_twice` cos 2q.

    Once a turn errs a disc off its axis, twice a magnet off its axis or a disc that leans.
    """

    summary = "an angle sensor's error repeats once and twice a turn: a disc or a magnet off its axis"
    where = "every sensor of a hinge joint's angle"
    kernel = staticmethod(eccentric)

    @classmethod
    def sites(cls, model: mujoco.MjModel) -> list[str]:
        return [object_name(model, "sensor", s) for s in range(model.nsensor) if _is_angle(model, s)]

    @property
    def parameters(self):
        names = ("sine", "cosine", "sine_twice", "cosine_twice")
        # rad, of each amplitude: the reading still grows with the angle where all four are as large
        largest = 0.05
        return tuple(Parameter(name, "rad", -largest, largest, 0.0) for name in names)

    def undone(self, derivatives, values):
        sine, cosine, sine_twice, cosine_twice = values.T[..., None]
        reported, slope, curvature = np.moveaxis(derivatives, 1, 0)
        angle = reported
        inversions = 20  # fixed-point steps: each leaves at most 0.3 of the error
        for _ in range(inversions):
            error = eccentric(
                angle, sine=sine, cosine=cosine, sine_twice=sine_twice, cosine_twice=cosine_twice
            )
            angle = reported - (error - angle)
        once, twice = (np.sin(angle), np.cos(angle)), (np.sin(2 * angle), np.cos(2 * angle))
        gain = 1 + sine * once[1] - cosine * once[0] + 2 * (sine_twice * twice[1] - cosine_twice * twice[0])
        bend = -(sine * once[0] + cosine * once[1]) - 4 * (sine_twice * twice[0] + cosine_twice * twice[1])
        true_slope = slope / gain
        return np.stack([angle, true_slope, (curvature - bend * np.square(true_slope)) / gain], axis=1)


def _is_angle(model: mujoco.MjModel, sensor: int) -> bool:
    """Whether the sensor reports the angle of a hinge joint."""
    if int(model.sensor_type[sensor]) != int(mujoco.mjtSensor.mjSENS_JOINTPOS):
        return False
    return int(model.jnt_type[model.sensor_objid[sensor]]) == HINGE
