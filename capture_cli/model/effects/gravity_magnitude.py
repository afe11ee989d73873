"""Gravity of another size."""

from capture_cli.model.effects.base import GLOBAL, Effect
from capture_cli.model.parameters import Parameter


class GravityMagnitude(Effect):
    """`change` of gravity relative to the model's: 0.02 is 2 % more. Also buoyancy, or a counterweight."""

    place = "model"
    summary = "gravity is stronger or weaker than modelled"
    where = "the model as a whole, where it has gravity"
    parameters = (Parameter("change", "1", -1.0, 1.0, 0.0),)  # from what floats to twice

    @classmethod
    def sites(cls, model):
        return [GLOBAL] if model.opt.gravity.any() and model.nv else []

    def write(self, fields, values):
        gravity = fields["opt.gravity"]
        gravity *= 1 + values
