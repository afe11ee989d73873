"""Actuators whose force is linear in the parameters of their gain and bias: neither muscles nor dcmotors."""

import mujoco
import numpy as np

from capture_cli.model.effects._places import site_id
from capture_cli.model.effects._scales import driven_joint
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.object_names import object_name

# Fields of MjModel, (actuator, ...), with all of which together the force of such an actuator scales
SCALED = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")
_G = mujoco.mjtGain
_GAINS = [int(_G.mjGAIN_FIXED), int(_G.mjGAIN_AFFINE), int(_G.mjGAIN_PID)]
_BIASES = [int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)]


def linear_actuators(model: mujoco.MjModel) -> list[int]:
    """Their ids."""
    linear = np.isin(model.actuator_gaintype, _GAINS) & np.isin(model.actuator_biastype, _BIASES)
    return [int(a) for a in np.flatnonzero(linear)]


class OnJoint:
    """At an `actuator` of those, of an effect at the joint that it drives."""

    where = "every actuator on a hinge or slide joint whose force is linear: no muscle and no dcmotor"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.actuator = site_id(model, "actuator", site)

    @classmethod
    def sites(cls, model):
        linear = linear_actuators(model)
        return [object_name(model, "actuator", a) for a in linear if driven_joint(model, a) >= 0]

    @classmethod
    def joint_at(cls, model, site):
        return object_name(model, "joint", driven_joint(model, site_id(model, "actuator", site)))
