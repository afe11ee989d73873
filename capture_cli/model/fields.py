"""Copies of a model's fields, one for each of many simulations."""

from typing import Self

import mujoco
import numpy as np


class ModelFields:
    """Per-simulation copies of a model's fields, (simulation, ...), made when first asked for.

    Names are those of MjModel ("dof_damping") and, with the prefix "opt.", of MjOption ("opt.gravity").
    substeps: steps of "opt.timestep" in one of the grid on which controls come and sensors are read.
    """

    def __init__(self, model: mujoco.MjModel, simulations: int):
        self.model = model
        self.simulations = simulations
        self.substeps = 1
        self.values: dict[str, np.ndarray] = {}

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.values:
            nominal = np.asarray(model_field(self.model, name), dtype=float)
            self.values[name] = np.repeat(nominal[None], self.simulations, axis=0)
        return self.values[name]

    def rows(self, simulations: np.ndarray) -> Self:
        """Those of the simulations of these numbers."""
        fields = ModelFields(self.model, len(simulations))
        fields.substeps = self.substeps
        fields.values = {name: values[simulations] for name, values in self.values.items()}
        return fields


def model_field(model: mujoco.MjModel, name: str) -> np.ndarray:
    """The model's own value of a field named as in ModelFields."""
    return getattr(model.opt, name[4:]) if name.startswith("opt.") else getattr(model, name)
