"""A body that loses or gains mass as it works: a tank, a can, a hopper, a spool."""

import numpy as np

from capture_cli.model.effects._growth import growing, growing_companion
from capture_cli.model.effects._places import ObjectEffect, source
from capture_cli.model.effects._scales import moving_bodies
from capture_cli.model.parameters import Parameter

SCALED = ("body_mass", "body_inertia")


def steadily(time, *, rate):
    """How many times as large at `time`, s, since it began: 1 + rate time."""
    return 1 + rate * np.maximum(time, 0.0)


class MassChange(ObjectEffect):
    """The body's mass and inertia are 1 + `rate` (1/s) t times as large, t since the episode began: it is filled anew
    before each, and what leaves it takes its momentum along.
    """

    place, kind = "force", "body"
    summary = "a body that loses or gains mass as it works: a tank, a spray can, a hopper, a spool"
    where = "every moving body with mass"

    @classmethod
    def suited(cls, model):
        # MuJoCo has the inertia of a body that was compiled as `simple` from a constant
        return [b for b in moving_bodies(model) if not model.body_simple[b]]

    @property
    def parameters(self):
        usual = 20.0  # s, that an episode takes where no log says
        most = 0.8 / (self.longest or usual)  # of the mass, that an episode adds or takes away
        return (Parameter("rate", "1/s", -most, most, 0.0),)

    def force(self, values, timestep, *, began=0.0, **_):
        return growing(steadily, self.coefficients(values), began, SCALED, self.number)

    def companion(self, name, values):
        at = f"body = {source(self.model, 'body', self.site)}.id"
        fields = [f"model.{field}" for field in SCALED]
        return growing_companion(name, steadily, self.numbers(values), at, fields)
