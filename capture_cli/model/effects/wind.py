"""A medium that moves: MuJoCo's wind."""

from capture_cli.model.effects._medium import MediumEffect
from capture_cli.model.parameters import Parameter


class Wind(MediumEffect):
    """Velocity (m/s) added to the medium's; it acts where the medium has density or viscosity."""

    summary = "the medium moves: wind or a current"

    @property
    def parameters(self):
        storm = 20.0  # m/s
        return tuple(Parameter(axis, "m/s", -storm, storm, 0.0) for axis in "xyz")

    def write(self, fields, values):
        wind = fields["opt.wind"]
        wind += values
