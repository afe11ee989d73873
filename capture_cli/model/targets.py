"""Targets: what a parameter can set in a model.

A target reads its nominal value from a compiled model and writes per-simulation values into ModelFields, so that
one compiled model serves a whole batch.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.model.fields import ModelFields, model_field


@frozen
class SETTINGS:
    contact_stiffness: float = 5000.0  # 1/s^2, for a restitution on a geom whose solref is not in direct form
    contact_impedance: float = 0.95  # MuJoCo's default solimp dmax


class Target(ABC):
    """One number of a model.

    scales: whether it multiplies what other targets may set; it is then written before them, so that a number that is
    set is what it says it is.
    """

    scales: ClassVar[bool] = False

    @abstractmethod
    def read(self, model: mujoco.MjModel) -> float:
        """The model's own value, SI."""

    @abstractmethod
    def write(self, fields: ModelFields, values: np.ndarray) -> None:
        """Set the number to `values` (simulation,) in every simulation."""


@dataclass(frozen=True)
class FieldTarget(Target):
    """The entries `index` of one model field; all of them get the same value."""

    field: str
    index: tuple

    def read(self, model):
        return float(np.asarray(model_field(model, self.field))[self.index].flat[0])

    def write(self, fields, values):
        entries = fields[self.field][(slice(None), *self.index)]
        fields[self.field][(slice(None), *self.index)] = np.reshape(values, (-1,) + (1,) * (entries.ndim - 1))


@dataclass(frozen=True)
class BodyMass(Target):
    """Mass, kg; the inertia follows in proportion, as for a body of the same shape."""

    scales = True
    body: int

    def read(self, model):
        return float(model.body_mass[self.body])

    def write(self, fields, values):
        mass = fields["body_mass"][:, self.body]
        # a point mass where there was none
        ratio = np.divide(values, mass, out=np.ones(len(mass)), where=mass > 0)
        fields["body_mass"][:, self.body] = values
        fields["body_inertia"][:, self.body] *= ratio[:, None]


@dataclass(frozen=True)
class BodyInertia(Target):
    """A factor on the three principal moments of inertia (1: as in the model)."""

    scales = True
    body: int

    def read(self, model):
        return 1.0

    def write(self, fields, values):
        fields["body_inertia"][:, self.body] *= values[:, None]


@dataclass(frozen=True)
class GeomSize(Target):
    """The first of a primitive geom's sizes, m, others in proportion; its body's mass does not follow."""

    scales = True
    geom: int

    def read(self, model):
        return float(model.geom_size[self.geom, 0])

    def write(self, fields, values):
        size = fields["geom_size"]
        size[:, self.geom] *= (values / size[:, self.geom, 0])[:, None]


@dataclass(frozen=True)
class Restitution(Target):
    """Coefficient of restitution of a geom's contacts, through solref in direct form (-stiffness, -damping).

    For a contact of impedance d, K = stiffness / d, D = damping / d and z = D / (2 sqrt(K)):
    e = exp(-z / s * atan2(2 z s, 2 z^2 - 1)), s = sqrt(1 - z^2), whatever the speed.
    """

    geom: int

    def read(self, model):
        stiffness, damping = self._direct(model.geom_solref[None, self.geom])
        ratio = damping / SETTINGS.contact_impedance / (2 * np.sqrt(stiffness / SETTINGS.contact_impedance))
        return float(restitution(np.clip(ratio, 0, 1 - 1e-9))[0])

    def write(self, fields, values):
        solref = fields["geom_solref"]
        stiffness, _ = self._direct(solref[:, self.geom])
        ratio = damping_ratio(values)
        solref[:, self.geom, 0] = -stiffness
        solref[:, self.geom, 1] = (
            -ratio * 2 * np.sqrt(stiffness / SETTINGS.contact_impedance) * SETTINGS.contact_impedance
        )

    @staticmethod
    def _direct(solref: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        is_direct = solref[:, 0] < 0
        stiffness = np.where(is_direct, -solref[:, 0], SETTINGS.contact_stiffness)
        damping = np.where(
            is_direct,
            -solref[:, 1],
            solref[:, 1] * 2 * np.sqrt(SETTINGS.contact_stiffness * SETTINGS.contact_impedance),
        )
        return stiffness, damping


@dataclass(frozen=True)
class ActuatorBias(Target):
    """Entry `column` of an actuator's bias: a constant (N or N m), or a factor on its length or its velocity.

    An actuator without a bias (a <motor>) is given an affine one.
    """

    actuator: int
    column: int

    def read(self, model):
        return float(model.actuator_biasprm[self.actuator, self.column])

    def write(self, fields, values):
        fields["actuator_biastype"][:, self.actuator] = int(mujoco.mjtBias.mjBIAS_AFFINE)
        fields["actuator_biasprm"][:, self.actuator, self.column] = values


@dataclass(frozen=True)
class ServoGain(Target):
    """Gain of a servo on its length (column 1, kp) or its velocity (2, kv): what pulls back, and with it what follows
    the control, where that is `commanded`.
    """

    actuator: int
    column: int
    commanded: bool

    def read(self, model):
        return -float(model.actuator_biasprm[self.actuator, self.column])

    def write(self, fields, values):
        fields["actuator_biasprm"][:, self.actuator, self.column] = -values
        if self.commanded:
            fields["actuator_gainprm"][:, self.actuator, 0] = values


@dataclass(frozen=True)
class MotorNumber(Target):
    """Of a voltage-driven motor, of gain k/R and back-EMF bias -k^2/R: its torque constant k, N m/A (`number` 0), or
    its winding resistance R, ohm (1); the other is kept.
    """

    actuator: int
    number: int

    def read(self, model):
        return self._both(model.actuator_gainprm[None], model.actuator_biasprm[None])[self.number].item()

    def write(self, fields, values):
        gain, bias = fields["actuator_gainprm"], fields["actuator_biasprm"]
        both = self._both(gain, bias)
        both[self.number] = values
        constant, resistance = both
        gain[:, self.actuator, 0] = constant / resistance
        bias[:, self.actuator, 2] = -(constant**2) / resistance

    def _both(self, gain: np.ndarray, bias: np.ndarray) -> list[np.ndarray]:
        """k and R, (simulation,) each, of gain g = k/R and velocity bias b = -k^2/R: k = -b/g, R = -b/g^2."""
        g, b = gain[:, self.actuator, 0], bias[:, self.actuator, 2]
        return [-b / g, -b / g**2]


def restitution(ratio: np.ndarray) -> np.ndarray:
    """Coefficient of restitution of a damped spring contact of damping ratio `ratio` in [0, 1)."""
    s = np.sqrt(1 - np.square(ratio))
    return np.exp(-ratio / s * np.arctan2(2 * ratio * s, 2 * np.square(ratio) - 1))


def damping_ratio(values: np.ndarray) -> np.ndarray:
    """The damping ratio whose restitution is `values`; the inverse of `restitution`, by a dense table."""
    grid = np.sin(np.linspace(0, np.pi / 2, 20_001)[:-1])  # dense where the function is steep
    return np.interp(-np.asarray(values), -restitution(grid), grid)
