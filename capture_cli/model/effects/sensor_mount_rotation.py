"""A sensor of orientation, or a device of several sensors, that is misaligned with its body."""

import mujoco
import numpy as np

from capture_cli.model.effects._kernel import OWN_STEP, Companion, call
from capture_cli.model.effects._places import site_id
from capture_cli.model.effects._rotation import SETTINGS as ROTATION
from capture_cli.model.effects._rotation import rotate, rotate_in_own_frame
from capture_cli.model.effects._sensor_effect import (
    SensorEffect,
    columns_of,
    columns_source,
    devices,
    quantity,
)
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.object_names import object_name
from capture_cli.model.parameters import Parameter
from capture_cli.model.quaternion_signs import is_quaternion

_S = mujoco.mjtSensor
VECTORS = (  # told in the frame of their site
    _S.mjSENS_GYRO,
    _S.mjSENS_ACCELEROMETER,
    _S.mjSENS_VELOCIMETER,
    _S.mjSENS_MAGNETOMETER,
    _S.mjSENS_FORCE,
    _S.mjSENS_TORQUE,
)


class SensorMountRotation(SensorEffect):
    """The orientation that a sensor reports is that of a frame turned on its body by a rotation vector (rad).

    The angular velocities that are read off it turn, too. Sensors at one site of the model are one device,
    SENSOR+SENSOR: an IMU that is misaligned tells its orientation, rates and accelerations in the turned frame. Only
    what is fixed to the body shows it, unequal inertia or forces: a ball that flies freely moves as one that began
    turned, and the start takes it up.
    """

    summary = "a sensor of orientation, or an IMU of several sensors, is misaligned with its body"
    where = "every sensor of an orientation, and the sensors of a site that turn with it together"
    parameters = tuple(
        Parameter(name, "rad", -ROTATION.largest_turn, ROTATION.largest_turn, 0.0) for name in "xyz"
    )

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.sensors = devices(model, _turns).get(site) or [site_id(model, "sensor", site)]

    @classmethod
    def sites(cls, model):
        attitudes = (s for s in range(model.nsensor) if quantity(model, s) and is_quaternion(model, s))
        return [object_name(model, "sensor", s) for s in attitudes] + list(devices(model, _turns))

    @property
    def columns(self):
        return np.r_[*(columns_of(self.model, s) for s in self.sensors)].tolist()

    def measured(self, sensors, values, timestep, **_):
        sensors = sensors.copy()
        for sensor in self.sensors:
            at = columns_of(self.model, sensor)
            sensors[..., at] = self._turned(sensor, sensors[..., at], values[:, None])
        return sensors

    def true_motion(self, derivatives, values, elapsed=0.0):
        return self.measured(derivatives, -values, 0.0)

    def companion(self, name, values):
        lines = []
        for sensor in self.sensors:
            kernel, sign = _kernel(self.model, sensor)
            reported, _ = call(name, kernel, ["sensors[..., at]"], {"rotation": sign * values}, OWN_STEP)
            at = columns_source(self.model, object_name(self.model, "sensor", sensor))
            lines += [f"at = {at}", f"sensors[..., at] = {reported}"]
        kernels = dict.fromkeys(_kernel(self.model, sensor)[0] for sensor in self.sensors)
        return Companion(tuple(kernels), tuple(lines))

    def _turned(self, sensor: int, reports: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        kernel, sign = _kernel(self.model, sensor)
        return kernel(reports, rotation=sign * rotation)


def _kernel(model: mujoco.MjModel, sensor: int):
    """What turns the reports of `sensor`, and the sign of the rotation: a vector is told in the frame that turned."""
    return (rotate_in_own_frame, 1.0) if is_quaternion(model, sensor) else (rotate, -1.0)


def _turns(model: mujoco.MjModel, sensor: int) -> bool:
    """Whether what `sensor` reports depends on how its site is turned on its body, as this effect has it."""
    return is_quaternion(model, sensor) or mujoco.mjtSensor(int(model.sensor_type[sensor])) in VECTORS
