"""A control that is cut off earlier than modelled."""

from capture_cli.model.effects._actuator_effect import UNIT, ActuatorEffect
from capture_cli.model.effects._limited import saturated, unlimited_at
from capture_cli.model.parameters import Parameter


class ControlSaturation(ActuatorEffect):
    """Controls beyond +-`limit` (in the control's own unit) arrive as `limit`; at its null, the end of its range,
    nothing is cut off. Beyond that, where the control has no range of its own, it cuts off as it does below.

    A limit that no control reaches moves nothing, so the outputs have no slope at null.
    """

    summary = "a control is cut off earlier than modelled"
    has_threshold = True
    kernel = staticmethod(saturated)

    @property
    def parameters(self):
        # MuJoCo itself cuts off at ctrlrange; where there is none, controls may be larger than they seem
        high = self.scale * (1 if self.model.actuator_ctrllimited[self.actuators[0]] else 2)
        return (Parameter("limit", UNIT, 0.02 * self.scale, high, high),)

    def coefficients(self, values):
        return {"limit": unlimited_at(self.parameters[0].nominal, values[:, 0])}
