"""What effects on a sensor's reports share: which sensors there are, and their units."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from capture_cli.model.effects._kernel import OWN_STEP, Companion, bound, call
from capture_cli.model.effects._places import site_id, source, with_all_together
from capture_cli.model.effects._scales import (
    GRAVITY,
    HINGE,
    SLIDE,
    characteristic_force,
    characteristic_speed,
    driven_joint,
    extent,
    travel,
)
from capture_cli.model.effects.base import GLOBAL, Effect
from capture_cli.model.object_names import object_name
from capture_cli.model.parameters import Parameter
from capture_cli.model.quaternion_signs import QUATERNIONS, is_quaternion

FAST_TURN = 5.0  # rad/s

_S = mujoco.mjtSensor
_JOINT = {_S.mjSENS_JOINTPOS: "position", _S.mjSENS_JOINTVEL: "speed", _S.mjSENS_JOINTACTFRC: "force"}
_ACTUATOR = {
    _S.mjSENS_ACTUATORPOS: "position",
    _S.mjSENS_ACTUATORVEL: "speed",
    _S.mjSENS_ACTUATORFRC: "force",
}
_POSITIONS = (_S.mjSENS_FRAMEPOS, _S.mjSENS_SUBTREECOM, _S.mjSENS_RANGEFINDER, _S.mjSENS_TENDONPOS)
_SPEEDS = (_S.mjSENS_FRAMELINVEL, _S.mjSENS_VELOCIMETER, _S.mjSENS_SUBTREELINVEL, _S.mjSENS_TENDONVEL)
_TURNS = (_S.mjSENS_FRAMEANGVEL, _S.mjSENS_GYRO, _S.mjSENS_BALLANGVEL)
_ACCELERATIONS = (_S.mjSENS_FRAMELINACC, _S.mjSENS_ACCELEROMETER)
_AXES = (_S.mjSENS_FRAMEXAXIS, _S.mjSENS_FRAMEYAXIS, _S.mjSENS_FRAMEZAXIS)
_FORCES = (_S.mjSENS_FORCE, _S.mjSENS_TOUCH)


@dataclass(frozen=True)
class Quantity:
    """What a sensor reports: its unit, and a size that its values commonly have."""

    unit: str
    size: float


def quantity(model: mujoco.MjModel, sensor: int) -> Quantity | None:
    """What `sensor` reports; None where that is no physical quantity known here."""
    kind, which = mujoco.mjtSensor(int(model.sensor_type[sensor])), int(model.sensor_objid[sensor])
    if kind in _JOINT:
        return _of_joint(model, which, _JOINT[kind])
    if kind in _ACTUATOR:
        joint = driven_joint(model, which)
        gear = abs(float(model.actuator_gear[which, 0])) or 1.0
        through = {"position": gear, "speed": gear, "force": 1 / gear}[_ACTUATOR[kind]]
        return _of_joint(model, joint, _ACTUATOR[kind], through) if joint >= 0 else None
    weight = GRAVITY * float(model.body_subtreemass[0])
    speed = float(np.sqrt(2 * GRAVITY * extent(model)))
    for kinds, unit, size in (
        (_POSITIONS, "m", extent(model)),
        (_SPEEDS, "m/s", speed),
        (_TURNS, "rad/s", FAST_TURN),
        (_ACCELERATIONS, "m/s^2", GRAVITY),
        (_AXES, "1", 1.0),
        (QUATERNIONS, "1", 1.0),
        (_FORCES, "N", weight),
        ((_S.mjSENS_TORQUE,), "N m", weight * extent(model)),
        ((_S.mjSENS_SUBTREEANGMOM,), "kg m^2/s", weight * extent(model) * speed / GRAVITY),
        ((_S.mjSENS_MAGNETOMETER,), "T", max(float(np.linalg.norm(model.opt.magnetic)), 1e-9)),
    ):
        if kind in kinds:
            return Quantity(unit, size)
    return None


def _of_joint(model: mujoco.MjModel, joint: int, what: str, through: float = 1.0) -> Quantity | None:
    if model.jnt_type[joint] not in (HINGE, SLIDE):
        return None
    hinge = bool(model.jnt_type[joint] == HINGE)
    unit = {"position": ("m", "rad"), "speed": ("m/s", "rad/s"), "force": ("N", "N m")}[what][hinge]
    size = {"position": travel, "speed": characteristic_speed, "force": characteristic_force}[what](
        model, joint
    )
    return Quantity(unit, size * through)


def columns_of(model: mujoco.MjModel, sensor: int) -> slice:
    """The sensor's columns of sensordata."""
    first = int(model.sensor_adr[sensor])
    return slice(first, first + int(model.sensor_dim[sensor]))


def columns_source(model: mujoco.MjModel, site: str) -> str:
    """Source of the columns of a sensor."""
    sensor = source(model, "sensor", site)
    return f"{sensor}.adr[0] + np.arange({sensor}.dim[0])"


def devices(
    model: mujoco.MjModel, among: Callable[[mujoco.MjModel, int], bool] = lambda *_: True
) -> dict[str, list[int]]:
    """Those `among` the sensors that sit at one site, by the names of all of them, where there are several."""
    at: dict[int, list[int]] = {}
    for sensor in np.flatnonzero(model.sensor_objtype == int(mujoco.mjtObj.mjOBJ_SITE)):
        if among(model, int(sensor)):
            at.setdefault(int(model.sensor_objid[sensor]), []).append(int(sensor))
    several = (sensors for sensors in at.values() if len(sensors) > 1)
    return {"+".join(object_name(model, "sensor", s) for s in sensors): sensors for sensors in several}


class SensorEffect(Effect):
    """An effect on the reports of one sensor.

    kernel: of a series (..., grid, column) makes what is reported of it.
    """

    place = "measurement"
    where = "every sensor"
    kernel: ClassVar[Callable]

    @classmethod
    def sites(cls, model: mujoco.MjModel) -> list[str]:
        return [object_name(model, "sensor", s) for s in range(model.nsensor) if quantity(model, s)]

    @property
    def columns(self) -> slice | list[int]:
        """Columns of sensordata."""
        if self.site == GLOBAL:
            return slice(0, self.model.nsensordata)
        return columns_of(self.model, site_id(self.model, "sensor", self.site))

    @property
    def reported(self) -> frozenset[int]:
        return frozenset(np.arange(self.model.nsensordata)[self.columns].tolist())

    @property
    def columns_source(self) -> str:
        """The same, as source that knows the model."""
        return "slice(None)" if self.site == GLOBAL else columns_source(self.model, self.site)

    @property
    def quantity(self) -> Quantity:
        """What the sensor reports."""
        return quantity(self.model, site_id(self.model, "sensor", self.site))

    def coefficients(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """The kernel's coefficients, (simulation, 1 or column) each, from `values` (simulation, parameter)."""
        return {name: values[:, [i]] for i, name in enumerate(self.space.names)}

    @property
    def sizes(self) -> np.ndarray:
        """The size that values of each of its columns commonly have, (column,)."""
        sensors = range(self.model.nsensor)
        if self.site != GLOBAL:
            sensors = [site_id(self.model, "sensor", self.site)]
        found = [(quantity(self.model, s), int(self.model.sensor_dim[s])) for s in sensors]
        return np.concatenate([np.full(count, q.size if q else 1.0) for q, count in found])

    def measure(self, sensors, values, timestep, **_):
        return self.measured(sensors, values, timestep)

    def measured(self, sensors: np.ndarray, values: np.ndarray, timestep: float, **states: np.ndarray):
        """`measure`, the kernel's own states beginning at `states`, (simulation, column) each."""
        sensors = sensors.copy()
        every_step = {name: v[:, None] for name, v in {**self.coefficients(values), **states}.items()}
        reported = bound(self.kernel, every_step, timestep)
        sensors[..., self.columns] = reported(sensors[..., self.columns])
        return sensors

    def true_motion(self, derivatives, values, elapsed=0.0):
        true = derivatives.copy()
        true[..., self.columns] = self.undone(derivatives[..., self.columns], values)
        return true

    def undone(self, derivatives: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Derivatives (simulation, 3, column) of this sensor's columns without the effect: `true_motion`, in short."""
        return derivatives

    def companion(self, name, values):
        numbers = {n: v[0] if v.shape[1] > 1 else v[0, 0] for n, v in self.coefficients(values[None]).items()}
        reported, _ = call(name, self.kernel, ["sensors[..., at]"], numbers, OWN_STEP)
        return Companion((self.kernel,), (f"at = {self.columns_source}", f"sensors[..., at] = {reported}"))


class NumberEffect(SensorEffect):
    """An effect on the numbers that a sensor reports one by one."""

    where = "every sensor but those of orientation"

    @classmethod
    def sites(cls, model: mujoco.MjModel) -> list[str]:
        sensors = (s for s in range(model.nsensor) if quantity(model, s) and not is_quaternion(model, s))
        return [object_name(model, "sensor", s) for s in sensors]

    def for_each(self, name: str, unit: str, high: float) -> tuple[Parameter, ...]:
        """A parameter within `high` of 0 for each of the sensor's numbers: `name`, or x, y and z of several.

        In a log that has some of them, of those alone: nothing would show the others.
        """
        size = self.columns.stop - self.columns.start
        names = (name,) if size == 1 else "xyz"[:size]
        return tuple(Parameter(names[k], unit, -high, high, 0.0) for k in self._shown)

    def of_all(self, values: np.ndarray) -> np.ndarray:
        """Values (simulation, parameter) of `for_each` for all of the sensor's numbers, (simulation, column)."""
        every = np.zeros((len(values), self.columns.stop - self.columns.start))
        every[:, self._shown] = values
        return every

    @property
    def _shown(self) -> list[int]:
        """Which of the sensor's numbers the log has that it looks in; all of them where that has none."""
        first, end = self.columns.start, self.columns.stop
        own = [k - first for k in range(first, end) if self.logged is None or k in self.logged]
        return own or list(range(end - first))


class TimeEffect(SensorEffect):
    """An effect on when a sensor reports, or when all of them do."""

    where = "every sensor; all of them together where there are several"

    @classmethod
    def sites(cls, model: mujoco.MjModel) -> list[str]:
        return with_all_together(super().sites(model))
