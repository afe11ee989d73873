"""An actuator that gives less than its servo asks for: MuJoCo's forcerange."""

import mujoco
import numpy as np

from capture_cli.model.effects._limited import UNLIMITED
from capture_cli.model.effects._places import ObjectEffect
from capture_cli.model.effects._scales import actuator_force_scale, actuator_force_unit
from capture_cli.model.parameters import Parameter


class ActuatorForceLimit(ObjectEffect):
    """The actuator gives no more than `limit` (N or N m) either way; at its null, the end of its range, nothing is
    cut off. Beyond that, where the actuator has no forcerange, it cuts off as it does below.

    Of servos, whose force is not their control's alone; what a motor cannot give is control-saturation. A limit that no
    force reaches moves nothing, so the outputs have no slope at null.
    """

    place, kind = "model", "actuator"
    summary = "a servo gives less force than modelled"
    has_threshold = True
    where = "every actuator whose force depends on where it is or how fast"

    @classmethod
    def suited(cls, model):
        affine = model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)
        return np.flatnonzero(affine & model.actuator_biasprm[:, 1:3].any(axis=1))

    @property
    def own(self) -> np.ndarray:
        """The model's own limits (2,), N or N m."""
        limited = bool(self.model.actuator_forcelimited[self.number])
        return self.model.actuator_forcerange[self.number] if limited else np.array([-1, 1]) * UNLIMITED

    @property
    def parameters(self):
        scale = actuator_force_scale(self.model, self.number)
        own = float(np.abs(self.own).max())
        high = own if own < UNLIMITED else 2 * scale
        unit = actuator_force_unit(self.model, self.number)
        return (Parameter("limit", unit, 0.02 * scale, high, high),)

    def write(self, fields, values):
        limit = np.where(values[:, 0] == self.parameters[0].nominal, UNLIMITED, values[:, 0])
        fields["actuator_forcelimited"][:, self.number] = True
        low, high = self.own
        fields["actuator_forcerange"][:, self.number, 0] = np.maximum(low, -limit)
        fields["actuator_forcerange"][:, self.number, 1] = np.minimum(high, limit)
