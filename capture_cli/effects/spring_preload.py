"""A spring that rests elsewhere: MuJoCo's springref."""

from __future__ import annotations

import mujoco

from capture_cli.effects._joint_effect import JointEffect
from capture_cli.effects._places import site_id
from capture_cli.effects.base import GLOBAL
from capture_cli.parameters import Parameter


class SpringPreload(JointEffect):
    """`shift` (m or rad) of where the joint's spring is at rest. Without a spring, see constant-force."""

    place = "model"
    summary = "a joint's spring rests elsewhere than modelled"
    where = "every hinge and slide joint with a spring"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.position = int(model.jnt_qposadr[self.joint])

    @classmethod
    def sites(cls, model):
        joints = ((site, site_id(model, "joint", site)) for site in super().sites(model))
        return [site for site, j in joints if model.jnt_stiffness[j] > 0 or model.jnt_stiffnesspoly[j].any()]

    @property
    def parameters(self):
        return (Parameter("shift", self.unit("m", "rad"), -self.travel, self.travel, 0.0),)

    def write(self, fields, values):
        fields["qpos_spring"][:, self.position] += values[:, 0]
