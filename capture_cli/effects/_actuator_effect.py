"""What effects on an actuator's control share."""

from __future__ import annotations

from abc import abstractmethod

import mujoco
import numpy as np

from capture_cli.effects._places import site_id, site_name
from capture_cli.effects._scales import control_scale
from capture_cli.effects.base import GLOBAL, Effect

UNIT = "ctrl"  # whatever the control of the actuator is measured in


class ActuatorEffect(Effect):
    """An effect on the one control of an actuator. What came before a simulation began is taken to be its
    first value.
    """

    place = "control"
    where = "every actuator"

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

    def drive(self, controls, values, timestep):
        controls = controls.copy()
        controls[..., self.column] = self.changed(controls[..., self.column], values, timestep)
        return controls

    @abstractmethod
    def changed(self, control: np.ndarray, values: np.ndarray, timestep: float) -> np.ndarray:
        """`control` (simulation, grid), held over each step, as the actuator receives it."""
