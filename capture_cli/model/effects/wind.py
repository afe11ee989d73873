"""A medium that moves: MuJoCo's wind."""

from __future__ import annotations

from capture_cli.model.effects._scales import moving_bodies
from capture_cli.model.effects.base import GLOBAL, Effect
from capture_cli.model.parameters import Parameter


class Wind(Effect):
    """Velocity (m/s) added to the medium's; it acts where the medium has density or viscosity."""

    place = "model"
    summary = "the medium moves: wind or a current"
    where = "the model as a whole"

    @classmethod
    def sites(cls, model):
        return [GLOBAL] if moving_bodies(model) else []

    @property
    def parameters(self):
        storm = 20.0  # m/s
        return tuple(Parameter(axis, "m/s", -storm, storm, 0.0) for axis in "xyz")

    def write(self, fields, values):
        wind = fields["opt.wind"]
        wind += values
