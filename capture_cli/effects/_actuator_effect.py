"""What effects on an actuator's control share."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import mujoco
import numpy as np

from capture_cli.effects._kernel import Companion, bound, call
from capture_cli.effects._places import reference, site_id, site_name
from capture_cli.effects._scales import control_scale
from capture_cli.effects.base import GLOBAL, Effect

UNIT = "ctrl"  # whatever the control of the actuator is measured in


class ActuatorEffect(Effect):
    """An effect on the one control of an actuator. What came before a simulation began is taken to be its
    first value.

    kernel: of the control of one step, held over it, makes what the actuator receives.
    """

    place = "control"
    where = "every actuator"
    kernel: ClassVar[Callable]

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.actuator = site_id(model, "actuator", site)
        self.column = int(model.actuator_ctrladr[self.actuator])

    @classmethod
    def sites(cls, model: mujoco.MjModel) -> list[str]:
        return [
            site_name(model, "actuator", a) for a in range(model.nactuator) if model.actuator_ctrlnum[a] == 1
        ]

    @property
    def scale(self) -> float:
        """How large the control is, in its own unit."""
        return control_scale(self.model, self.actuator)

    def coefficients(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """The kernel's coefficients, (simulation,) each, from `values` (simulation, parameter)."""
        return dict(zip(self.space.names, values.T, strict=True))

    def drive(self, controls, values, timestep):
        controls = controls.copy()
        arrive = bound(self.kernel, self.coefficients(values), timestep)
        for step in range(controls.shape[1]):
            controls[:, step, self.column] = arrive(controls[:, step, self.column])
        return controls

    def companion(self, name, values):
        numbers = {n: v[0] for n, v in self.coefficients(values[None]).items()}
        arrives, state = call(name, self.kernel, ["data.ctrl[at]"], numbers)
        actuator = f"model.actuator({reference(self.model, 'actuator', self.site)})"
        lines = (f"at = model.actuator_ctrladr[[{actuator}.id]]", f"data.ctrl[at] = {arrives}")
        return Companion((self.kernel,), lines, state)
