"""The viscosity of the medium the machine moves in: MuJoCo's linear drag on every body."""

from __future__ import annotations

import numpy as np

from capture_cli.model.effects._scales import GRAVITY, box_edges, moving_bodies
from capture_cli.model.effects.base import GLOBAL, Effect, raised
from capture_cli.model.parameters import Parameter


class MediumViscosity(Effect):
    """`viscosity` (Pa s) is added to the model's."""

    place = "model"
    summary = "drag of the medium on all bodies, in proportion to speed"
    where = "the model as a whole"

    @classmethod
    def sites(cls, model):
        return [GLOBAL] if moving_bodies(model) else []

    @property
    def parameters(self):
        own = float(self.model.opt.viscosity)
        most = 2 * max(self._sinking(b) for b in moving_bodies(self.model))
        return (Parameter("viscosity", "Pa s", min(0.0, -own), most, 0.0),)

    def write(self, fields, values):
        viscosity = fields["opt.viscosity"]
        viscosity[...] = raised(viscosity, values[:, 0])

    def _sinking(self, body: int) -> float:
        """Pa s: in which a ball of the body's mass and size sinks at the speed it has after falling one
        diameter.
        """
        diameter = float(np.mean(box_edges(self.model, body)))
        speed = np.sqrt(2 * GRAVITY * diameter)
        return float(self.model.body_mass[body]) * GRAVITY / (3 * np.pi * diameter * float(speed))
