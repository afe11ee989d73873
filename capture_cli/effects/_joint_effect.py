"""What effects at a hinge or slide joint share."""

from __future__ import annotations

from abc import abstractmethod

import mujoco
import numpy as np

from capture_cli.effects._places import site_id, site_name
from capture_cli.effects._scales import (
    HINGE,
    SLIDE,
    characteristic_force,
    characteristic_speed,
    driven_joint,
    inertia,
    travel,
)
from capture_cli.effects.base import GLOBAL, Effect
from capture_cli.parameters import Parameter


class JointEffect(Effect):
    """An effect at a joint with one degree of freedom. `is_hinge` decides between rad and m."""

    where = "every hinge and slide joint"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.joint = site_id(model, "joint", site)
        self.dof = int(model.jnt_dofadr[self.joint])
        self.is_hinge = int(model.jnt_type[self.joint]) == HINGE

    @classmethod
    def sites(cls, model: mujoco.MjModel) -> list[str]:
        return [
            site_name(model, "joint", j) for j in range(model.njnt) if model.jnt_type[j] in (HINGE, SLIDE)
        ]

    @property
    def characteristic_force(self) -> float:
        """N or N m."""
        return characteristic_force(self.model, self.joint)

    @property
    def characteristic_speed(self) -> float:
        """m/s or rad/s."""
        return characteristic_speed(self.model, self.joint)

    @property
    def travel(self) -> float:
        """m or rad."""
        return travel(self.model, self.joint)

    @property
    def inertia(self) -> float:
        """kg or kg m^2."""
        return inertia(self.model, self.joint)

    def unit(self, slide: str, hinge: str) -> str:
        """The unit of a quantity of this joint."""
        return hinge if self.is_hinge else slide

    def added(self, name: str, unit: str, own: float, high: float) -> Parameter:
        """A parameter added to the model's `own` value, such that the sum is not negative."""
        return Parameter(name, unit, min(0.0, -own), high, 0.0)


class SpringEffect(JointEffect):
    """An effect on where a joint's spring is at rest; `position` is the joint's place in qpos."""

    place = "model"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.position = int(model.jnt_qposadr[self.joint])

    @classmethod
    def sites(cls, model):
        return [s for s in super().sites(model) if cls.suits(model, site_id(model, "joint", s))]

    @classmethod
    @abstractmethod
    def suits(cls, model: mujoco.MjModel, joint: int) -> bool:
        """Whether the joint's spring, or that it has none, lets the effect sit there."""


def driven_joints(model: mujoco.MjModel) -> list[str]:
    """Sites of the joints that an actuator drives."""
    joints = {driven_joint(model, a) for a in range(model.nactuator)} - {-1}
    return [site_name(model, "joint", j) for j in sorted(joints)]


def raised(own: np.ndarray, change: np.ndarray) -> np.ndarray:
    """own + change, kept from passing below zero: friction and damping never drive."""
    return np.maximum(own + change, np.minimum(own, 0.0))
