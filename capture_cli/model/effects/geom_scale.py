"""Geoms that are larger or smaller than modelled."""

from __future__ import annotations

import mujoco
import numpy as np

from capture_cli.model.contacts import touching_pairs
from capture_cli.model.effects._places import site_id
from capture_cli.model.effects.base import GLOBAL, Effect
from capture_cli.model.object_names import object_name
from capture_cli.model.parameters import Parameter

SIZED = [
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{k}")) for k in ("SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX")
]


class GeomScale(Effect):
    """`change` of all sizes of a geom in proportion: 0.1 is 10 % larger. Mass and inertia stay."""

    place = "model"
    summary = "a geom that touches is larger or smaller than modelled"
    where = "every sphere, capsule, ellipsoid, cylinder and box that can touch something"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.geom = site_id(model, "geom", site)

    @classmethod
    def sites(cls, model):
        named = np.concatenate([model.pair_geom1, model.pair_geom2])
        touching = np.union1d(touching_pairs(model), named).astype(int)
        return [object_name(model, "geom", int(g)) for g in touching if model.geom_type[g] in SIZED]

    @property
    def parameters(self):
        return (Parameter("change", "1", -0.2, 0.2, 0.0),)

    def write(self, fields, values):
        fields["geom_size"][:, self.geom] *= 1 + values
