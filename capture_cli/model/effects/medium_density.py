"""The density of the medium the machine moves in: MuJoCo's quadratic drag on every body."""

import numpy as np

from capture_cli.model.effects._medium import MediumEffect
from capture_cli.model.effects._raised import Raised
from capture_cli.model.effects._scales import box_edges, moving_bodies


class MediumDensity(Raised, MediumEffect):
    """`density` (kg/m^3) is added to the model's. Air is 1.2, water 1000; MuJoCo has no buoyancy.

    Drag follows the box (or, where the model says so, the ellipsoid) that MuJoCo takes each body for.
    """

    summary = "drag of the medium on all bodies, in proportion to speed squared"
    field = "opt.density"

    @property
    def parameters(self):
        # in a medium denser than that the lightest body would float
        bodies = moving_bodies(self.model)
        lightest = min(self.model.body_mass[b] / box_edges(self.model, b).prod() for b in bodies)
        return self.added("density", "kg/m^3", float(np.clip(lightest, 5.0, 1500.0)))
