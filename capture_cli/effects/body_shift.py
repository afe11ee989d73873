"""A body that is fixed elsewhere to the one before it than modelled: a link of another length."""

from __future__ import annotations

import mujoco

from capture_cli.effects._places import site_id
from capture_cli.effects._turning_axes import axes_that_show, reach, turning_joints
from capture_cli.effects.base import GLOBAL, Effect
from capture_cli.parameters import Parameter
from capture_cli.sim.object_names import object_name

MOST = 0.2  # of the size of the body that it is fixed to
LOOPS = [int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)]


class BodyShift(Effect):
    """Shift (m) of a body, with all that hangs on it, along the axes of the body it is fixed to: a link that is longer
    than modelled, a tool that is mounted askew.

    A shift along the only axis that that body can turn about shows nothing but a steady offset, and is left out; so is
    all of it where a constraint closes a loop, whose starts would have to follow it.
    """

    place = "model"
    summary = "a link is longer or shorter than modelled, or what follows it sits elsewhere"
    where = "every body with mass that hangs on one that some joint can turn, if no constraint closes a loop"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.body = site_id(model, "body", site)
        self.parent = int(model.body_parentid[self.body])
        self.axes = axes_that_show(model, self.parent)

    @classmethod
    def sites(cls, model):
        if any(kind in LOOPS for kind in model.eq_type):
            return []
        hanging = (
            b
            for b in range(1, model.nbody)
            if model.body_subtreemass[b] > 0 and turning_joints(model, model.body_parentid[b])
        )
        return [object_name(model, "body", b) for b in hanging]

    @property
    def parameters(self):
        most = MOST * reach(self.model, self.parent, self.model.body_pos[self.body])
        return tuple(Parameter("xyz"[i], "m", -most, most, 0.0) for i in self.axes)

    def write(self, fields, values):
        fields["body_pos"][:, self.body, self.axes] += values
