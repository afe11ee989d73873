"""Geoms that are larger or smaller than modelled."""

import mujoco
import numpy as np

from capture_cli.model.contacts import touching_pairs
from capture_cli.model.effects._places import ObjectEffect
from capture_cli.model.parameters import Parameter

SIZED = [
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{k}")) for k in ("SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX")
]


class GeomScale(ObjectEffect):
    """`change` of all sizes of a geom in proportion: 0.1 is 10 % larger. Mass and inertia stay."""

    place, kind = "model", "geom"
    summary = "a geom that touches is larger or smaller than modelled"
    where = "every sphere, capsule, ellipsoid, cylinder and box that can touch something"
    parameters = (Parameter("change", "1", -0.2, 0.2, 0.0),)

    @classmethod
    def suited(cls, model):
        named = np.concatenate([model.pair_geom1, model.pair_geom2])
        touching = np.union1d(touching_pairs(model), named).astype(int)
        return [g for g in touching if model.geom_type[g] in SIZED]

    def write(self, fields, values):
        fields["geom_size"][:, self.number] *= 1 + values
