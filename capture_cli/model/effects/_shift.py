"""What sits elsewhere on a body than modelled: how an effect moves it, along the axes on which it shows."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from capture_cli.model.effects._turning_axes import axes_that_show, reach
from capture_cli.model.effects.base import Effect
from capture_cli.model.parameters import Parameter


class Shift(Effect):
    """Shift (m) of row `number` of a field of positions, along the axes of `body` but the only one that turns it.

    field: of MjModel, (row, 3). most: of the body's size, or of how far out the row is, either way. Subclasses say
    `number` and `body` with `sits`.
    """

    place = "model"
    field: ClassVar[str]
    most: ClassVar[float] = 0.5

    def sits(self, number: int, body: int) -> None:
        """Which row it moves, and the body in whose frame that is."""
        self.number, self.body = number, body
        self.axes = axes_that_show(self.model, body)

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
