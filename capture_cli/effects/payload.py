"""Mass that a body carries and the model does not know of."""

from __future__ import annotations

import mujoco
import numpy as np

from capture_cli.effects._inertia import add_point_mass
from capture_cli.effects._places import site_id
from capture_cli.effects._scales import moving_bodies
from capture_cli.effects.base import GLOBAL, Effect
from capture_cli.parameters import Parameter
from capture_cli.sim.object_names import object_name

FARTHEST = 3.0  # times the distance of the centre of mass; the end of a rod is at 2


class Payload(Effect):
    """A point of `mass` (kg), fixed to a body on the line from its frame through its centre of mass.

    `reach` (m) is how far from the frame it sits. Where the centre of mass is in the frame's origin, it sits
    there.
    """

    place = "model"
    summary = "a body carries mass that the model does not know of"
    where = "every moving body with mass"
    shapes = ("reach",)

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.body = site_id(model, "body", site)
        self.centre = model.body_ipos[self.body].copy()
        self.distance = float(np.linalg.norm(self.centre))

    @classmethod
    def sites(cls, model):
        return [object_name(model, "body", b) for b in moving_bodies(model)]

    @property
    def parameters(self):
        mass = Parameter("mass", "kg", 0.0, 2 * float(self.model.body_mass[self.body]), 0.0)
        if self.distance < 1e-6:
            return (mass,)
        return (mass, Parameter("reach", "m", 0.2 * self.distance, FARTHEST * self.distance, self.distance))

    def write(self, fields, values):
        if self.distance < 1e-6:
            position = fields["body_ipos"][:, self.body]
        else:
            position = values[:, 1:] * self.centre / self.distance
        add_point_mass(fields, self.body, values[:, 0], position)
