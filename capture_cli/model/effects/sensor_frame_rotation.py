"""A sensor of vectors that is misaligned, or calibrated so; an orientation told in a frame that is turned."""

import itertools

import mujoco
import numpy as np

from capture_cli.model.effects._places import site_id, source
from capture_cli.model.effects._rotation import SETTINGS as ROTATION
from capture_cli.model.effects._rotation import rotate, rotate_quaternions
from capture_cli.model.effects._scales import SLIDE
from capture_cli.model.effects._sensor_effect import SensorEffect, quantity
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.object_names import object_name
from capture_cli.model.parameters import Parameter
from capture_cli.model.quaternion_signs import is_quaternion

PERPENDICULAR = 1e-6


def turned_in_plane(series, *, angle):
    """Vectors (..., 2), turned by angle (rad) from the first axis towards the second."""
    sine, cosine = np.sin(angle), np.cos(angle)
    first, second = series[..., :1], series[..., 1:]
    return np.concatenate([cosine * first - sine * second, sine * first + cosine * second], axis=-1)


class SensorFrameRotation(SensorEffect):
    """What a sensor of a vector or an orientation reports, turned by a rotation vector (rad).

    That is the frame the numbers are told in: of gyros and accelerometers on the body, of positions and orientations
    in the world. A sensor of orientation that is misaligned with its body is `sensor-mount-rotation`.

    Two sensors of the same kind on perpendicular slide joints of one body are a vector in the plane,
    SENSOR+SENSOR, turned by one `angle` from the first towards the second.
    """

    summary = "a sensor's frame is turned: a misaligned camera, gyro or accelerometer, a north that is off"
    where = "every sensor of a vector or an orientation, every pair of sensors on perpendicular slides"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.pair = _planes(model).get(site)

    @classmethod
    def sites(cls, model):
        vectors = (s for s in range(model.nsensor) if quantity(model, s) and model.sensor_dim[s] in (3, 4))
        return [object_name(model, "sensor", s) for s in vectors] + list(_planes(model))

    @property
    def parameters(self):
        names = ("angle",) if self.pair else ("x", "y", "z")
        return tuple(
            Parameter(name, "rad", -ROTATION.largest_turn, ROTATION.largest_turn, 0.0) for name in names
        )

    @property
    def kernel(self):
        if self.pair:
            return turned_in_plane
        is_attitude = is_quaternion(self.model, site_id(self.model, "sensor", self.site))
        return rotate_quaternions if is_attitude else rotate

    def coefficients(self, values):
        return {"angle" if self.pair else "rotation": values}

    def undone(self, derivatives, values):
        return self.kernel(derivatives, **{n: -v[:, None] for n, v in self.coefficients(values).items()})

    @property
    def columns(self):
        return [int(self.model.sensor_adr[s]) for s in self.pair] if self.pair else super().columns

    @property
    def columns_source(self):
        if not self.pair:
            return super().columns_source
        kind = "sensor"
        names = (object_name(self.model, kind, s) for s in self.pair)
        return f"[{', '.join(f'{source(self.model, kind, name)}.adr[0]' for name in names)}]"


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
            planes[f"{object_name(model, 'sensor', a)}+{object_name(model, 'sensor', b)}"] = (a, b)
    return planes
