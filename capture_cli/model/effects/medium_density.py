"""The density of the medium the machine moves in: MuJoCo's quadratic drag on every body."""

from __future__ import annotations

import numpy as np

from capture_cli.model.effects._scales import box_edges, moving_bodies
from capture_cli.model.effects.base import GLOBAL, Effect, raised
from capture_cli.model.parameters import Parameter


class MediumDensity(Effect):
    """`density` (kg/m^3) is added to the model's. Air is 1.2, water 1000; MuJoCo has no buoyancy.

    Drag follows the box (or, where the model says so, the ellipsoid) that MuJoCo takes each body for.
    """

    place = "model"
    summary = "drag of the medium on all bodies, in proportion to speed squared"
    where = "the model as a whole"

    @classmethod
    def sites(cls, model):
        return [GLOBAL] if moving_bodies(model) else []

    @property
    def parameters(self):
        own = float(self.model.opt.density)
        # in a medium denser than that the lightest body would float
        bodies = moving_bodies(self.model)
        lightest = min(self.model.body_mass[b] / box_edges(self.model, b).prod() for b in bodies)
        return (Parameter("density", "kg/m^3", min(0.0, -own), float(np.clip(lightest, 5.0, 1500.0)), 0.0),)

    def write(self, fields, values):
        density = fields["opt.density"]
        density[...] = raised(density, values[:, 0])
