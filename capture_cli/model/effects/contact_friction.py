"""Friction of what touches: MuJoCo's geom and pair friction."""

import numpy as np

from capture_cli.model.effects._contacts import ContactEffect
from capture_cli.model.effects.base import raised
from capture_cli.model.parameters import Parameter


class ContactFriction(ContactEffect):
    """`change`, added to the coefficient of sliding friction of geoms' contacts, or of an explicit pair's.

    In a contact the geom with more friction decides. Where it is lowered, partners that would decide instead
    go down with it.
    """

    place = "model"
    summary = "contacts slide more or less easily than modelled"

    @property
    def has_threshold(self):
        """Beside a geom that has more friction it does nothing until it has the most."""
        friction = self.model.geom_friction[:, 0]
        return self.pair < 0 and bool((friction[self.partners] > friction[self.geoms[0]]).any())

    @property
    def parameters(self):
        own = (
            self.model.pair_friction[self.pair] if self.pair >= 0 else self.model.geom_friction[self.geoms[0]]
        )
        return (Parameter("change", "1", min(0.0, -float(own[0])), 1.0, 0.0),)

    def write(self, fields, values):
        if self.pair >= 0:
            friction = fields["pair_friction"]
            friction[:, self.pair, :2] = raised(friction[:, self.pair, :2], values)
            return
        friction = fields["geom_friction"]
        for geom in self.geoms:
            own, others = friction[:, geom, :1].copy(), friction[:, self.partners, 0]
            new = raised(own, values)
            friction[:, self.partners, 0] = np.where(others <= own, np.minimum(others, new), others)
            friction[:, geom, 0] = new[:, 0]

    @staticmethod
    def decides(model, a, b):
        return model.geom_friction[a, 0] >= model.geom_friction[b, 0]

    @staticmethod
    def matters(model, a, b):
        return np.maximum(model.geom_condim[a], model.geom_condim[b]) > 1

    @staticmethod
    def pair_matters(model, pair):
        return model.pair_dim[pair] > 1
