"""Dry friction that holds, where MuJoCo's gives way a little: the softness of frictionloss."""

import numpy as np

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.parameters import Parameter


class FrictionHardness(JointEffect):
    """MuJoCo's frictionloss is a soft constraint: a joint that it holds creeps, and stops in some milliseconds.

    `hardness` (decades): softness and time constant are divided by 10 to this power (solimpfriction, solreffriction; a
    time constant of less than two steps counts as two steps). Where there is no dry friction it changes nothing.
    """

    place = "model"
    summary = "dry friction holds and stops harder than modelled"
    # most decades: then the impedance is near the 0.9999 that MuJoCo allows, and friction as hard as of a real machine
    shares = ("hardness",)
    parameters = (Parameter("hardness", "1", 0.0, 3.0, 0.0),)
    shows_at_rest = True

    def write(self, fields, values):
        ratio = 10 ** values[:, 0]
        impedance = fields["dof_solimp"][:, self.dof, :2]  # (1 - d) / d is the softness
        impedance /= impedance + (1 - impedance) / ratio[:, None]
        reference = fields["dof_solref"][:, self.dof]
        standard = reference[:, 0] > 0  # (time constant, damping ratio); otherwise -stiffness and -damping
        reference[:, 0] = np.where(standard, reference[:, 0] / ratio, reference[:, 0])
        reference[:, 1] = np.where(standard, reference[:, 1], reference[:, 1] * ratio)
