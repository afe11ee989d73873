"""How much a collision gives back: the damping of MuJoCo's contacts."""

import numpy as np

from capture_cli.model.effects._contacts import ContactEffect
from capture_cli.model.parameters import Parameter

DAMPING = 1  # the number of solref that is a damping ratio, or minus damping where it is in direct form


class ContactRestitution(ContactEffect):
    """`damping` is the relative change of the contact damping of geoms, or of an explicit pair.

    Less damping gives back more: at -1 nothing would be lost. Of two geoms with solref in direct form the one
    with more damping decides; two in standard form are averaged. Where damping is lowered, partners that
    would decide instead go down with it.
    """

    place = "model"
    summary = "collisions give back more or less than modelled"
    parameters = (Parameter("damping", "1", -0.95, 9.0, 0.0),)

    def write(self, fields, values):
        if self.pair >= 0:
            fields["pair_solref"][:, self.pair, DAMPING] *= 1 + values[:, 0]
            return
        damping = fields["geom_solref"][..., DAMPING]
        for geom in self.geoms:
            own, others = damping[:, geom, None].copy(), damping[:, self.partners]
            new = own * (1 + values)
            follows = (own < 0) & (others < 0) & (others >= own)
            damping[:, self.partners] = np.where(follows, np.maximum(others, new), others)
            damping[:, geom] = new[:, 0]

    @staticmethod
    def decides(model, a, b):
        damping, direct = model.geom_solref[:, DAMPING], model.geom_solref[:, 0] < 0
        return ~direct[b] | (direct[a] & (damping[a] <= damping[b]))

    @staticmethod
    def matters(model, a, b):
        return model.geom_solref[a, DAMPING] != 0

    @staticmethod
    def pair_matters(model, pair):
        return model.pair_solref[pair, DAMPING] != 0
