"""A body that is fixed elsewhere to the one before it than modelled: a link of another length."""

from __future__ import annotations

import mujoco

from capture_cli.model.effects._places import site_id
from capture_cli.model.effects._shift import Shift
from capture_cli.model.effects._turning_axes import turning_joints
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.object_names import object_name

LOOPS = [int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)]


class BodyShift(Shift):
    """Shift (m) of a body, with all that hangs on it, along the axes of the body it is fixed to: a link that is longer
    than modelled, a tool that is misaligned.

    A shift along the only axis that that body can turn about shows nothing but a steady offset, and is left out; so is
    all of it where a constraint closes a loop, whose starts would have to follow it.
    """

    summary = "a link is longer or shorter than modelled, or what follows it sits elsewhere"
    where = "every body with mass that hangs on one that some joint can turn, if no constraint closes a loop"
    field = "body_pos"
    most = 0.2

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        body = site_id(model, "body", site)
        self.sits(body, int(model.body_parentid[body]))

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
