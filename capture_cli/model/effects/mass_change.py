"""A body that loses or gains mass as it works: a tank, a can, a hopper, a spool."""

import numpy as np

from capture_cli.model.effects._elapsed import Elapsed
from capture_cli.model.effects._kernel import Companion, call
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
        rate = values[:, 0]
        began = np.broadcast_to(began, len(values))

        def force(world):
            growth = steadily(world.time - began[world.rows], rate=rate[world.rows])
            world.vary("body_mass")[:, self.number] *= growth
            world.vary("body_inertia")[:, self.number] *= growth[:, None]

        return force

    def companion(self, name, values):
        elapsed, state = call(name, Elapsed, ["data.time"], {})
        growth, _ = call(name, steadily, ["elapsed"], {"rate": values[0]})
        fields = tuple(f"model.{field}" for field in SCALED)
        lines = (
            f"body = {source(self.model, 'body', self.site)}.id",
            f"elapsed = {elapsed}",
            f"growth = {growth}",
            *(f"{field}[body] *= growth" for field in fields),
        )
        return Companion((Elapsed, steadily), lines, state, fields)
