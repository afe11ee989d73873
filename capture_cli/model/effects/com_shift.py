"""A centre of mass that lies elsewhere than modelled."""

from __future__ import annotations

import mujoco

from capture_cli.model.effects._places import site_id
from capture_cli.model.effects._scales import moving_bodies
from capture_cli.model.effects._shift import Shift
from capture_cli.model.effects._turning_axes import turning_joints
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.object_names import object_name


class ComShift(Shift):
    """Shift (m) of a body's centre of mass along the axes of the body's frame; the mass stays as it is.

    A shift along the only axis that the body can turn about moves nothing, and is left out. So are bodies
    that no joint turns, and bodies that were compiled as `simple`, whose centre MuJoCo cannot move; those of
    a task never are.
    """

    summary = "a body's centre of mass lies elsewhere than modelled"
    where = "every body with mass that some joint can turn"
    field = "body_ipos"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        body = site_id(model, "body", site)
        self.sits(body, body)

    @classmethod
    def sites(cls, model):
        turned = (b for b in moving_bodies(model) if not model.body_simple[b] and turning_joints(model, b))
        return [object_name(model, "body", b) for b in turned]
