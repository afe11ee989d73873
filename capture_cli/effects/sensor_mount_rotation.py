"""A sensor of orientation that is mounted askew on its body."""

from __future__ import annotations

from capture_cli.effects._rotation import LARGEST_TURN, rotate_in_own_frame
from capture_cli.effects._sensor_effect import SensorEffect, quantity
from capture_cli.parameters import Parameter
from capture_cli.sim.object_names import object_name
from capture_cli.sim.quaternion_signs import is_quaternion


class SensorMountRotation(SensorEffect):
    """The orientation a sensor reports is that of a frame turned on its body by a rotation vector (rad).

    The angular velocities that are read off it turn, too. Only what is fixed to the body shows it, unequal inertia or
    forces: a ball that flies freely moves as one that began turned, and the start takes it up.
    """

    summary = "a sensor of orientation is mounted askew on its body, as an IMU may be"
    where = "every sensor of an orientation"
    kernel = staticmethod(rotate_in_own_frame)

    @classmethod
    def sites(cls, model):
        attitudes = (s for s in range(model.nsensor) if quantity(model, s) and is_quaternion(model, s))
        return [object_name(model, "sensor", s) for s in attitudes]

    @property
    def parameters(self):
        return tuple(Parameter(name, "rad", -LARGEST_TURN, LARGEST_TURN, 0.0) for name in "xyz")

    def coefficients(self, values):
        return {"rotation": values}

    def undone(self, jets, values):
        return self.kernel(jets, rotation=-values[:, None])
