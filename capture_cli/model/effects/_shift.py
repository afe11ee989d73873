"""What sits elsewhere on a body than modelled: how an effect moves it, along the axes on which it shows."""

from abc import abstractmethod
from typing import ClassVar

import mujoco
import numpy as np

from capture_cli.model.effects._places import ObjectEffect
from capture_cli.model.effects._turning_axes import axes_that_show, reach
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.parameters import Parameter


class Shift(ObjectEffect):
    """Shift (m) of row `number` of a field of positions, along the axes of `body` but the only one that turns it.

    field: of MjModel, (row, 3). most: of the body's size, or of how far out the row is, either way.
    """

    place = "model"
    field: ClassVar[str]
    most: ClassVar[float] = 0.5

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.body = self.carrier(model, self.number)
        self.axes = axes_that_show(model, self.body)

    @staticmethod
    @abstractmethod
    def carrier(model: mujoco.MjModel, number: int) -> int:
        """The body in whose frame the row is."""

    @property
    def position(self) -> np.ndarray:
        """m, as modelled, (3,)."""
        return getattr(self.model, self.field)[self.number]

    @property
    def parameters(self):
        most = self.most * reach(self.model, self.body, self.position)
        return tuple(Parameter("xyz"[i], "m", -most, most, 0.0) for i in self.axes)

    def write(self, fields, values):
        fields[self.field][:, self.number, self.axes] += values
