"""The viscosity of the medium the machine moves in: MuJoCo's linear drag on every body."""

import numpy as np

from capture_cli.model.effects._medium import MediumEffect
from capture_cli.model.effects._raised import Raised
from capture_cli.model.effects._scales import GRAVITY, box_edges, moving_bodies


class MediumViscosity(Raised, MediumEffect):
    """`viscosity` (Pa s) is added to the model's."""

    summary = "drag of the medium on all bodies, in proportion to speed"
    field = "opt.viscosity"

    @property
    def parameters(self):
        most = 2 * max(self._sinking(b) for b in moving_bodies(self.model))
        return self.added("viscosity", "Pa s", most)

    def _sinking(self, body: int) -> float:
        """Pa s: in which a ball of the body's mass and size sinks at the speed it has after falling one
        diameter.
        """
        diameter = float(np.mean(box_edges(self.model, body)))
        speed = np.sqrt(2 * GRAVITY * diameter)
        return float(self.model.body_mass[body]) * GRAVITY / (3 * np.pi * diameter * float(speed))
