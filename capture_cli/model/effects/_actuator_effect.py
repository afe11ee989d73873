"""What effects on an actuator's control share."""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from inspect import isclass
from typing import ClassVar, Self

import mujoco
import numpy as np

from capture_cli.model.effects._kernel import OWN_STEP, Companion, bound, call
from capture_cli.model.effects._places import ids_source, site_id, with_all_together
from capture_cli.model.effects._scales import control_scale
from capture_cli.model.effects.base import GLOBAL, Effect
from capture_cli.model.object_names import object_name

UNIT = "ctrl"  # whatever the control of the actuator is measured in


class ActuatorEffect(Effect):
    """An effect on the one control of an actuator, or of several.

    kernel: of the control of one step, held over it, makes what the actuator receives.
    """

    place = "control"
    where = "every actuator"
    kernel: ClassVar[Callable]

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.names = [site] if site != GLOBAL else self.together(model)
        self.actuators = [site_id(model, "actuator", name) for name in self.names]
        self.columns = model.actuator_ctrladr[self.actuators]

    @classmethod
    def sites(cls, model: mujoco.MjModel) -> list[str]:
        return single_control_actuators(model)

    @classmethod
    def together(cls, model: mujoco.MjModel) -> list[str]:
        """Names of the actuators that it acts on where it acts on all of them."""
        return single_control_actuators(model)

    @property
    def columns_source(self) -> str:
        """Where the controls stand in ctrl, as source that knows the model."""
        return f"model.actuator_ctrladr[{ids_source(self.model, 'actuator', self.actuators)}]"

    @property
    def scale(self) -> float:
        """How large the control is, in its own unit."""
        return control_scale(self.model, self.actuators[0])

    def drive(self, controls, values, timestep, **_):
        each = np.repeat(values, len(self.columns), axis=0)  # a row for every control of every simulation
        sent = controls[:, :, self.columns].swapaxes(0, 1)
        arrived = self.arrived(sent.reshape(len(sent), -1), self.coefficients(each), timestep)
        controls = controls.copy()
        controls[:, :, self.columns] = arrived.reshape(sent.shape).swapaxes(0, 1)
        return controls

    def among(self, columns: np.ndarray) -> Self:
        """The same, but for rounding, where of all controls there are only these `columns` of ctrl, in order, its own
        among them.
        """
        found = copy(self)
        found.columns, found.arrived = np.searchsorted(columns, self.columns), self.at_once
        return found

    def at_once(
        self, told: np.ndarray, coefficients: Mapping[str, np.ndarray], timestep: float
    ) -> np.ndarray:
        """As `arrived`, but for rounding, by fewer operations where there is a way."""
        return self.arrived(told, coefficients, timestep)

    def arrived(
        self, told: np.ndarray, coefficients: Mapping[str, np.ndarray], timestep: float
    ) -> np.ndarray:
        """What the kernel makes of the controls of all steps, (step, row)."""
        arrive = bound(self.kernel, coefficients, timestep)
        return np.array([arrive(now) for now in told]) if isclass(self.kernel) else arrive(told)

    def companion(self, name, values):
        many = len(self.columns)
        coefficients = self.coefficients(np.repeat(values[None], many, axis=0))
        numbers = {n: v if many > 1 else v[0] for n, v in coefficients.items()}
        arrives, state = call(name, self.kernel, ["data.ctrl[at]"], numbers, OWN_STEP)
        lines = (f"at = {self.columns_source}", f"data.ctrl[at] = {arrives}")
        return Companion((self.kernel,), lines, state)


CONTROL_BEFORE = (
    "`ACTUATOR before`: by how much its control before the episode began differed from the first one, for ever. At 1 "
    "by the largest control of its `ctrlrange`; without one, by 1 m or rad of a position servo, and else by what gives "
    "the force of its `forcerange`, or holds the weight on its joint"
)


class RememberingEffect(ActuatorEffect):
    """An effect by which what arrives depends on earlier controls, too.

    Those before an episode began are states of their own: a robot may have been told to stand where it stood.
    """

    states_before = True
    states_mean = CONTROL_BEFORE

    @property
    def states(self):
        return tuple(f"{name} before" for name in self.names)

    def before(self, states):
        return controls_before(self.model, self.actuators, states)


def controls_before(model: mujoco.MjModel, actuators: Sequence[int], states: np.ndarray) -> np.ndarray:
    """What `Effect.before` gives where `states` (simulation, actuator) are those of `actuators`."""
    change = np.zeros((len(states), model.nu))
    change[:, model.actuator_ctrladr[actuators]] = states * [control_scale(model, a) for a in actuators]
    return change


class ControlTimeEffect(RememberingEffect):
    """An effect on when the control of one actuator arrives, or those of all of them, which share a bus."""

    where = "every actuator; all of them together where there are several"

    @classmethod
    def sites(cls, model: mujoco.MjModel) -> list[str]:
        return with_all_together(super().sites(model))


def single_control_actuators(model: mujoco.MjModel) -> list[str]:
    """Names of the actuators that take one control."""
    return [
        object_name(model, "actuator", a) for a in range(model.nactuator) if model.actuator_ctrlnum[a] == 1
    ]


def without_target(model: mujoco.MjModel) -> list[str]:
    """Those of them whose control is no target of a servo."""
    return [
        name
        for name in single_control_actuators(model)
        if model.actuator_biasprm[site_id(model, "actuator", name), 1] == 0
    ]
