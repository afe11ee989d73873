"""A body that is fixed elsewhere to the one before it than modelled: a link of another length."""

import mujoco
import numpy as np

from capture_cli.model.effects._shift import Shift
from capture_cli.model.effects._turning_axes import turning_joints

LOOPS = [int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)]


class BodyShift(Shift):
    """Shift (m) of a body, with all that hangs on it, along the axes of the body it is fixed to: a link that is longer
    than modelled, a tool that is misaligned.

    A shift along the only axis that that body can turn about shows nothing but a steady offset, and is left out; so is
    all of it where a constraint closes a loop, whose starts would have to follow it.
    """

    summary = "a link is longer or shorter than modelled, or what follows it sits elsewhere"
    where = "every body with mass that hangs on one that some joint can turn, if no constraint closes a loop"
    kind, field = "body", "body_pos"
    most = 0.2

    @staticmethod
    def carrier(model, number):
        return int(model.body_parentid[number])

    @classmethod
    def suited(cls, model):
        if any(kind in LOOPS for kind in model.eq_type):
            return []
        massive = np.flatnonzero(model.body_subtreemass[1:] > 0) + 1
        return [b for b in massive if turning_joints(model, model.body_parentid[b])]
