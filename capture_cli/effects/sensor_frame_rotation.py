"""A sensor that was mounted, or calibrated, askew."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np

from capture_cli.effects._places import site_id, site_name
from capture_cli.effects._rotation import rotate, rotate_quaternions
from capture_cli.effects._scales import SLIDE
from capture_cli.effects._sensor_effect import columns_of, is_quaternion, quantity
from capture_cli.effects.base import GLOBAL, Effect
from capture_cli.parameters import Parameter

LARGEST = 0.3  # rad
PERPENDICULAR = 1e-6


class SensorFrameRotation(Effect):
    """What a sensor of a vector or an orientation reports, turned by a rotation vector (rad).

    Two sensors of the same kind on perpendicular slide joints of one body are a vector in the plane,
    SENSOR+SENSOR, turned by one `angle` from the first towards the second.
    """

    place = "measurement"
    summary = "a sensor's frame is turned: a camera or an IMU mounted askew"
    where = "every sensor of a vector or an orientation, every pair of sensors on perpendicular slides"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        pairs = _planes(model)
        self.is_plane = site in pairs
        if self.is_plane:
            self.columns = [int(model.sensor_adr[s]) for s in pairs[site]]
            return
        sensor = site_id(model, "sensor", site)
        self.columns = columns_of(model, sensor)
        self.turn = rotate_quaternions if is_quaternion(model, sensor) else rotate

    @classmethod
    def sites(cls, model):
        vectors = (s for s in range(model.nsensor) if quantity(model, s) and model.sensor_dim[s] in (3, 4))
        return [site_name(model, "sensor", s) for s in vectors] + list(_planes(model))

    @property
    def parameters(self):
        names = ("angle",) if self.is_plane else ("x", "y", "z")
        return tuple(Parameter(name, "rad", -LARGEST, LARGEST, 0.0) for name in names)

    def measure(self, sensors, values, timestep):
        sensors = sensors.copy()
        series = sensors[..., self.columns]
        if self.is_plane:
            sine, cosine = np.sin(values), np.cos(values)
            first, second = series[..., 0], series[..., 1]
            turned = np.stack([cosine * first - sine * second, sine * first + cosine * second], axis=-1)
        else:
            turned = self.turn(series, np.broadcast_to(values[:, None], (*series.shape[:2], 3)))
        sensors[..., self.columns] = turned
        return sensors


def _planes(model: mujoco.MjModel) -> dict[str, tuple[int, int]]:
    """Pairs of sensors of the same kind on perpendicular slide joints of one body, by name."""
    kinds = [int(mujoco.mjtSensor.mjSENS_JOINTPOS), int(mujoco.mjtSensor.mjSENS_JOINTVEL)]
    scalar = [s for s in range(model.nsensor) if model.sensor_type[s] in kinds]
    slides = [s for s in scalar if model.jnt_type[model.sensor_objid[s]] == SLIDE]
    planes = {}
    for a, b in itertools.combinations(slides, 2):
        joints = model.sensor_objid[[a, b]]
        same = (
            model.jnt_bodyid[joints[0]] == model.jnt_bodyid[joints[1]]
            and model.sensor_type[a] == model.sensor_type[b]
        )
        if same and abs(model.jnt_axis[joints[0]] @ model.jnt_axis[joints[1]]) < PERPENDICULAR:
            planes[f"{site_name(model, 'sensor', a)}+{site_name(model, 'sensor', b)}"] = (a, b)
    return planes
