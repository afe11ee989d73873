"""A control that arrives through a first-order filter: the windings of a motor, a current controller."""

from capture_cli.common.frozen import frozen
from capture_cli.common.recursive_filter import recursion
from capture_cli.log.windows import SETTINGS as WINDOWS
from capture_cli.model.effects._actuator_effect import ControlTimeEffect
from capture_cli.model.effects._lag import Lag, left_behind
from capture_cli.model.parameters import Parameter


@frozen
class SETTINGS:
    forgotten: float = 20.0  # time constants, after which 2e-9 of a deviation is left


class ControlLag(ControlTimeEffect):
    """The control arrives through a first-order lag of `time_constant` (s). It is the mean over a step that
    arrives.
    """

    summary = "a control arrives through a first-order lag"
    kernel = Lag
    remembers = f"{SETTINGS.forgotten:g} `time_constant`, {WINDOWS.lead:g} s at most"
    parameters = (Parameter("time_constant", "s", 0.0, 0.5, 0.0),)  # in `lead` 3e-4 of it is left

    def memory(self, values):
        return min(SETTINGS.forgotten * float(values.max()), WINDOWS.lead)

    def at_once(self, told, coefficients, timestep):
        lag = Lag(**coefficients, timestep=timestep)
        return told + lag.mean * recursion(lag.kept[None, None], left_behind(told)[:, None])[:, 0]
